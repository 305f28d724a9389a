"""Planar pushing as a domain for the registry."""

import pytest

from service.model.domain import Domain
from service.model.loaded_model import LoadedModel
from service.model.tensors import ContextKind, Tensor
from service.pushing.domain import PUSHING
from service.pushing.gates import physics_gates
from service.pushing.onnx_interface import OUTPUTS, expected_inputs
from tests.fakes import FakePredictor, draft_manifest

DOMAIN: Domain = PUSHING  # mypy checks here that the class fits the protocol


@pytest.mark.parametrize("kind", ContextKind)
def test_the_domain_has_the_tensors_of_push_models(kind: ContextKind) -> None:
    """A registry gets the inputs of each kind of context, and the outputs of every push model."""
    assert DOMAIN.inputs(kind) == expected_inputs(kind)
    older, newer = (DOMAIN.outputs(kind, number) for number in (2, 3))
    with_distance = (*OUTPUTS, Tensor("unfamiliarity", "float32", ("n", 2), ("1", "1")))
    if kind is ContextKind.SHAPE:
        assert older == newer == (with_distance,)
    else:
        assert (older, newer) == ((OUTPUTS,), (OUTPUTS, with_distance))


def test_the_domain_has_the_physics_gates() -> None:
    """A registry gets the verdicts of the physics gates on a loaded version."""
    model = LoadedModel(draft_manifest(), "", FakePredictor(b"", takes_context=True))
    verdicts = list(DOMAIN.gates(model))
    assert verdicts == list(physics_gates(model))
    assert [verdict.gate for verdict in verdicts] == ["no-contact", "turned", "angle-at-pi"]
