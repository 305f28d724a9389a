"""Parity of torch and onnxruntime: exported graphs pass, and graphs with an altered constant do not."""

import numpy as np
import onnx
import pytest
import torch
from onnx import numpy_helper
from torch import Tensor, nn

from service.errors import CazslError, PublishError
from service.model.onnx_graph import inspect_graph
from service.model.tensors import ContextKind
from service.pushing.onnx_interface import OUTPUTS_WITH_UNFAMILIARITY
from tests.training.publishing.published_graphs import KINDS
from training.networks.mechanics import PushMechanics
from training.networks.methods import METHODS
from training.networks.omnipush_domain import OmnipushDomain
from training.networks.push_network import PUSH_SHAPES, PushNetwork
from training.publishing.onnx_export import export_module, export_onnx
from training.publishing.parity import PARITY_TOLERANCE, SHAPE_TOLERANCE, check_parity, check_shape_parity
from training.publishing.parity_inputs import plausible_batch

METHOD_CELLS = [(name, kind) for name, method in METHODS.items() for kind in ContextKind if method.takes(kind)]


def with_scaled_constant(graph: bytes, name: str, factor: float) -> bytes:
    """Return the same graph with one of its constants multiplied."""
    model = onnx.load_from_string(graph)
    (tensor,) = [tensor for tensor in model.graph.initializer if tensor.name == name]
    tensor.CopyFrom(numpy_helper.from_array(numpy_helper.to_array(tensor) * np.float32(factor), name))
    return bytes(model.SerializeToString())


@pytest.mark.parametrize("kind", KINDS)
def test_onnxruntime_agrees_with_torch(
    graphs: dict[ContextKind, bytes],
    networks: dict[ContextKind, PushNetwork],
    domains: dict[ContextKind, OmnipushDomain],
    scales: dict[ContextKind, float],
    kind: ContextKind,
) -> None:
    """The parity check of an exported graph returns a difference within the tolerance."""
    assert 0.0 <= check_parity(networks[kind], graphs[kind], kind, domains[kind], scales[kind]) <= PARITY_TOLERANCE


@pytest.mark.parametrize(
    ("kind", "constant"),
    [
        (ContextKind.INDICATOR, "network.context_encoder.weight"),
        (ContextKind.INDICATOR, "network.third.weight"),
        (ContextKind.INDICATOR, "output_std"),
        (ContextKind.VISUAL, "network.context_encoder.dense.weight"),
        (ContextKind.NONE, "network.first.bias"),
        (ContextKind.NONE, "network.last.bias"),
        (ContextKind.NONE, "input_std"),
    ],
)
@pytest.mark.parametrize("factor", [-1.0, 1.01], ids=["sign flipped", "one percent more"])
def test_a_graph_that_differs_from_torch_is_refused(
    graphs: dict[ContextKind, bytes],
    networks: dict[ContextKind, PushNetwork],
    domains: dict[ContextKind, OmnipushDomain],
    scales: dict[ContextKind, float],
    kind: ContextKind,
    constant: str,
    factor: float,
) -> None:
    """The parity check refuses a graph with one altered constant, of a layer or of the normalisation."""
    graph = with_scaled_constant(graphs[kind], constant, factor)

    # The predictor itself refuses a negative std, before the comparison.
    with pytest.raises(CazslError) as caught:
        check_parity(networks[kind], graph, kind, domains[kind], scales[kind])

    assert isinstance(caught.value, PublishError) or (constant, factor) == ("output_std", -1.0)


@pytest.mark.parametrize(("name", "kind"), [cell for cell in METHOD_CELLS if cell[0] != "ANP"])
def test_every_served_method_becomes_a_graph_that_agrees_with_it(name: str, kind: ContextKind) -> None:
    """Every served method exports to a graph that passes the parity check and has no training-only part."""
    torch.manual_seed(12)
    network = PushNetwork(METHODS[name], PUSH_SHAPES[kind])
    context = torch.from_numpy(plausible_batch(kind, 1, 32).contexts[0]) if kind is not ContextKind.NONE else None
    if context is not None:
        network.conditioning(context)  # in training mode, so that the batch norms record statistics
    graph = export_onnx(network, kind)

    assert check_parity(network, graph, kind) <= PARITY_TOLERANCE
    assert b"distance" not in graph, "the distance of the regulariser is not part of a served graph"


class Served(nn.Module):
    """Mechanics of one step, served as a shape model whose module is named like an output."""

    def __init__(self) -> None:
        super().__init__()
        self.mechanics = PushMechanics(steps=1)

    def forward(
        self, pusher: Tensor, silhouette: Tensor, outline: Tensor, support: Tensor, body: Tensor, context_index: Tensor
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Return mean, std and unfamiliarity."""
        found = self.mechanics(pusher, outline, support, body, context_index)
        filled = silhouette.mean(dim=(1, 2, 3))[context_index]
        std = 0.01 + 0.0 * found.motion + torch.exp(filled)[:, None]
        return found.motion, std, torch.stack([found.left, filled], dim=1)


@pytest.fixture(scope="module")
def shapes() -> bytes:
    """Return the graph of the mechanics."""
    return export_module(Served(), ContextKind.SHAPE, OUTPUTS_WITH_UNFAMILIARITY)


def test_a_shape_model_becomes_a_graph_that_agrees_with_it(shapes: bytes) -> None:
    """Mechanics exports to operators that a registry accepts, and onnxruntime agrees with torch."""
    assert inspect_graph(shapes).row_bytes > 0
    assert 0.0 <= check_shape_parity(Served(), shapes) <= SHAPE_TOLERANCE


def test_a_shape_graph_that_differs_from_torch_is_refused(shapes: bytes) -> None:
    """The parity check refuses a graph with one altered constant."""
    initializers = onnx.load_from_string(shapes).graph.initializer
    name = next(tensor.name for tensor in initializers if "differences" in tensor.name)
    with pytest.raises(PublishError, match="% of pushes"):
        check_shape_parity(Served(), with_scaled_constant(shapes, name, 3.0))
