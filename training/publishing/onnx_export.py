"""ONNX export of a fitted network.

The graph takes and gives SI units, so the published normalisation is inside it. Contexts are encoded once per object
and gathered per push.
"""

import logging
import warnings
from typing import Final

import onnx
import torch
from torch import Tensor, nn

from service.errors import PublishError
from service.model.tensors import ContextKind
from service.pushing.onnx_interface import OUTPUTS, expected_inputs
from training.networks.angles import wrapped
from training.networks.push_network import PushNetwork
from training.omnipush.published import published_normalisation
from training.publishing.parity_inputs import graph_inputs, plausible_batch

OPSET: Final = 18


class ServedNetwork(nn.Module):
    """Network with SI units in and out, as the ONNX interface of push models has it."""

    def __init__(self, network: PushNetwork) -> None:
        super().__init__()
        self.network = network
        known = published_normalisation()
        self.input_mean, self.input_std, self.output_mean, self.output_std = (
            nn.Buffer(torch.tensor(value, dtype=torch.float32))
            for value in (known.input_mean, known.input_std, known.output_mean, known.output_std)
        )

    def forward(
        self, pusher: Tensor, context: Tensor | None = None, context_index: Tensor | None = None
    ) -> tuple[Tensor, Tensor]:
        """Predict mean and std (n, 3) of pushes (n, 3) of the objects ``context[context_index]``."""
        mean, std = self.before_wrapping(pusher, context, context_index)
        return wrap_last(mean), std

    def before_wrapping(
        self, pusher: Tensor, context: Tensor | None = None, context_index: Tensor | None = None
    ) -> tuple[Tensor, Tensor]:
        """Predict like ``forward``, with the mean angle before wrapping, to which rounding errors are in proportion."""
        conditioning = None
        if context is not None and context_index is not None:
            conditioning = self.network.conditioning(context)  # (g, 256): once per object
            conditioning = None if conditioning is None else conditioning[context_index]  # (n, 256)
        mean, log_std = self.network.gaussian((wrap_last(pusher) - self.input_mean) / self.input_std, conditioning)
        return mean * self.output_std + self.output_mean, torch.exp(log_std) * self.output_std


def wrap_last(pose: Tensor) -> Tensor:
    """Wrap the angle of poses (n, 3) to (-pi, pi]."""
    position, angle = torch.split(pose, [2, 1], dim=-1)
    return torch.cat([position, wrapped(angle)], dim=-1)


def export_onnx(network: PushNetwork, kind: ContextKind) -> bytes:
    """Export a network as an ONNX graph in one file, without a trace of the machine that made it.

    Raises:
        PublishError: torch gave no ONNX program.
    """
    served = ServedNetwork(network).eval()
    example = plausible_batch(kind, pushes=3, objects=2)
    arguments = tuple(torch.from_numpy(array) for array in graph_inputs(example, kind))
    names = [tensor.name for tensor in expected_inputs(kind)]
    pushes, objects = torch.export.Dim("n"), torch.export.Dim("g")
    free = {"pusher": {0: pushes}, "context": {0: objects}, "context_index": {0: pushes}}
    logging.getLogger("torch.onnx").setLevel(logging.ERROR)  # its warnings are about operators that are not used
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # deprecations inside torch
        program = torch.onnx.export(
            served,
            arguments,
            input_names=names,
            output_names=[tensor.name for tensor in OUTPUTS],
            dynamic_shapes={name: free[name] for name in names},
            opset_version=OPSET,
            dynamo=True,
            verbose=False,
        )
    if program is None:
        raise PublishError("torch gave no ONNX program")
    model = program.model_proto
    strip_origin(model)
    onnx.checker.check_model(model, full_check=True)
    return bytes(model.SerializeToString(deterministic=True))


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
