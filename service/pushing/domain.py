"""Planar pushing as a domain for the registry: tensors and gates of push models."""

from collections.abc import Iterable
from typing import Final

from service.model.domain import Verdict
from service.model.loaded_model import LoadedModel
from service.model.tensors import ContextKind, Tensor
from service.pushing.gates import physics_gates
from service.pushing.onnx_interface import OUTPUTS, OUTPUTS_WITH_UNFAMILIARITY, UNFAMILIARITY_SINCE, expected_inputs


class PushDomain:
    """See ``service.model.domain.Domain``."""

    def inputs(self, kind: ContextKind) -> tuple[Tensor, ...]:
        """See ``Domain.inputs``."""
        return expected_inputs(kind)

    def outputs(self, kind: ContextKind, manifest_format: int) -> tuple[tuple[Tensor, ...], ...]:
        """See ``Domain.outputs``."""
        if kind is ContextKind.SHAPE:
            return (OUTPUTS_WITH_UNFAMILIARITY,)
        return (OUTPUTS,) if manifest_format < UNFAMILIARITY_SINCE else (OUTPUTS, OUTPUTS_WITH_UNFAMILIARITY)

    def gates(self, model: LoadedModel) -> Iterable[Verdict]:
        """See ``Domain.gates``."""
        return physics_gates(model)


PUSHING: Final = PushDomain()
