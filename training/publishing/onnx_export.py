"""ONNX export of a fitted network.

The graph takes and gives SI units, so the published normalisation is inside it. Contexts are encoded once per object
and gathered per push.
"""

import logging
import warnings
from collections.abc import Sequence
from typing import Final

import onnx
import torch
from torch import Tensor, nn

from service.errors import PublishError
from service.model.predictor import ROWS_AT_ONCE
from service.model.tensors import ContextKind
from service.model.tensors import Tensor as TensorRecord
from service.pushing.onnx_interface import OUTPUTS, OUTPUTS_WITH_UNFAMILIARITY, expected_inputs
from training.networks.angles import PushForm, wrapped
from training.networks.neural_process import NeuralProcess, Points
from training.networks.omnipush_domain import OmnipushDomain, SupportDomain
from training.networks.push_network import PushNetwork
from training.omnipush.published import published_normalisation
from training.publishing.parity_inputs import graph_inputs, plausible_batch

OPSET: Final = 18
_OWN: Final = "_of_the_graph"  # no operator has such a name


class ServedNetwork(nn.Module):
    """Network with SI units in and out, as the ONNX interface of push models has it.

    Its deviations are the network's times ``scale``. With a ``domain`` it also gives the unfamiliarity of each push.
    """

    def __init__(self, network: PushNetwork, domain: OmnipushDomain | None = None, scale: float = 1.0) -> None:
        super().__init__()
        self.network = network
        self.domain = domain
        self.scale = scale
        known = published_normalisation()
        self.input_mean, self.input_std, self.output_mean, self.output_std = (
            nn.Buffer(torch.tensor(value, dtype=torch.float32))
            for value in (known.input_mean, known.input_std, known.output_mean, known.output_std)
        )

    def forward(
        self, pusher: Tensor, context: Tensor | None = None, context_index: Tensor | None = None
    ) -> tuple[Tensor, ...]:
        """Predict mean and std (n, 3) of pushes (n, 3) of the objects ``context[context_index]``.

        With a domain, the third output is the unfamiliarity (n, 2).
        """
        mean, std = self.before_wrapping(pusher, context, context_index)
        if self.domain is None:
            return wrap_last(mean), std
        return wrap_last(mean), std, self.domain(pusher, context, context_index)

    def before_wrapping(
        self, pusher: Tensor, context: Tensor | None = None, context_index: Tensor | None = None
    ) -> tuple[Tensor, Tensor]:
        """Predict like ``forward``, with the mean angle before wrapping, to which rounding errors are in proportion."""
        conditioning = None
        if context is not None and context_index is not None:
            conditioning = self.network.conditioning(context)  # (g, 256): once per object
            if conditioning is not None:
                conditioning = torch.index_select(conditioning, 0, context_index)  # (n, 256)
        given = wrap_last(pusher) if self.network.form is PushForm.RAW else pusher  # the others take cosine and sine
        mean, log_std = self.network.gaussian((given - self.input_mean) / self.input_std, conditioning)
        return mean * self.output_std + self.output_mean, torch.exp(log_std) * (self.output_std * self.scale)


class ServedProcess(nn.Module):
    """Neural process with SI units in and out, of pushes whose objects are known by supports.

    Every object is learnt once, and each push meets what is known of its own. Deviations are the network's times the
    factor of the number of pushes in the support: ``scales`` has one factor for each of 0 to 50.
    """

    def __init__(self, network: NeuralProcess, domain: SupportDomain, scales: Tensor) -> None:
        super().__init__()
        self.network = network
        self.domain = domain
        self.scales = nn.Buffer(scales)
        known = published_normalisation()
        self.input_mean, self.input_std, self.output_mean, self.output_std = (
            nn.Buffer(torch.tensor(value, dtype=torch.float32))
            for value in (known.input_mean, known.input_std, known.output_mean, known.output_std)
        )

    def forward(
        self,
        pusher: Tensor,
        support_pushers: Tensor,
        support_outcomes: Tensor,
        support_valid: Tensor,
        context_index: Tensor,
    ) -> tuple[Tensor, ...]:
        """Predict mean, std (n, 3) and unfamiliarity (n, 2) of pushes (n, 3).

        Pushers and outcomes of supports are (g, 50, 3). They are valid (g, 50) where they are not padding.
        """
        mean, std = self.before_wrapping(pusher, support_pushers, support_outcomes, support_valid, context_index)
        support = _padded(support_pushers), _padded(support_outcomes), _padded(support_valid)
        return wrap_last(mean), std, self.domain(pusher, context_index, support)

    def before_wrapping(
        self,
        pusher: Tensor,
        support_pushers: Tensor,
        support_outcomes: Tensor,
        support_valid: Tensor,
        context_index: Tensor,
    ) -> tuple[Tensor, Tensor]:
        """Predict like ``forward``, with the mean angle before wrapping, to which rounding errors are in proportion."""
        support_pushers, support_outcomes, support_valid = map(
            _padded, (support_pushers, support_outcomes, support_valid)
        )
        inputs, support_inputs = ((given - self.input_mean) / self.input_std for given in (pusher, support_pushers))
        targets = (support_outcomes - self.output_mean) / self.output_std
        objects = self.network.adapted(Points(support_inputs, targets, support_valid))
        mean, log_std = self.network.predict(objects.of(context_index), inputs[:, None, :])
        scale = torch.index_select(self.scales[support_valid.sum(dim=-1).long()], 0, context_index)
        std = torch.exp(log_std[:, 0]) * self.output_std * scale[:, None]
        return mean[:, 0] * self.output_std + self.output_mean, std


def _padded(support: Tensor) -> Tensor:
    """Pad a support (g, 50, ...) with zeros to rows that are a multiple of ``ROWS_AT_ONCE``.

    Then an object gets the same bits beside any other objects (see there).
    """
    return torch.cat([support, 0.0 * support[:, : -support.shape[1] % ROWS_AT_ONCE]], dim=1)


def wrap_last(pose: Tensor) -> Tensor:
    """Wrap the angle of poses (n, 3) to (-pi, pi]."""
    position, angle = torch.split(pose, [2, 1], dim=-1)
    return torch.cat([position, wrapped(angle)], dim=-1)


def export_onnx(
    network: PushNetwork, kind: ContextKind, domain: OmnipushDomain | None = None, scale: float = 1.0
) -> bytes:
    """Export a network as an ONNX graph in one file, without a trace of the machine that made it.

    ``domain`` and ``scale`` are those of ``ServedNetwork``.

    Raises:
        PublishError: torch gave no ONNX program.
    """
    return export_module(ServedNetwork(network, domain, scale), kind, graph_outputs(domain))


def export_module(served: nn.Module, kind: ContextKind, outputs: Sequence[TensorRecord]) -> bytes:
    """Export a module that takes the inputs of a kind of context, by their names, and returns these outputs.

    Raises:
        PublishError: torch gave no ONNX program.
    """
    example = plausible_batch(kind, pushes=3, objects=2)
    arguments = tuple(torch.from_numpy(array) for array in graph_inputs(example, kind))
    inputs = expected_inputs(kind)
    counts = {name: torch.export.Dim(name) for name in ("n", "g")}
    free = {tensor.name: {0: counts[str(tensor.shape[0])]} for tensor in inputs}
    logging.getLogger("torch.onnx").setLevel(logging.ERROR)  # its warnings are about operators that are not used
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # deprecations inside torch
        program = torch.onnx.export(
            served.eval(),
            arguments,
            input_names=list(free),
            output_names=[f"{tensor.name}{_OWN}" for tensor in outputs],
            dynamic_shapes=free,
            opset_version=OPSET,
            dynamo=True,
            verbose=False,
        )
    if program is None:
        raise PublishError("torch gave no ONNX program")
    model = program.model_proto
    strip_origin(model)
    _name_outputs(model.graph, [tensor.name for tensor in outputs])
    onnx.checker.check_model(model, full_check=True)
    return bytes(model.SerializeToString(deterministic=True))


def graph_outputs(domain: OmnipushDomain | None) -> tuple[TensorRecord, ...]:
    """Return the outputs of a graph with this domain, or without one."""
    return OUTPUTS if domain is None else OUTPUTS_WITH_UNFAMILIARITY


def _name_outputs(graph: onnx.GraphProto, names: Sequence[str]) -> None:
    """Give outputs their names. Torch names a value by its operator, so one inside may have the name of an output."""
    renamed = {f"{name}{_OWN}": name for name in names} | {name: f"{name}_inside" for name in names}
    for node in graph.node:
        for values in (node.input, node.output):
            values[:] = [renamed.get(value, value) for value in values]
    for value in (*graph.output, *graph.value_info):
        value.name = renamed.get(value.name, value.name)


def strip_origin(model: onnx.ModelProto) -> None:
    """Remove the source lines and paths of the exporting machine that torch writes into a graph."""
    del model.metadata_props[:]
    model.doc_string = ""
    model.graph.doc_string = ""
    for part in (model.graph, *model.graph.node, *model.graph.value_info, *model.graph.input, *model.graph.output):
        del part.metadata_props[:]
        part.doc_string = ""
    for tensor in model.graph.initializer:
        del tensor.metadata_props[:]
        tensor.doc_string = ""
