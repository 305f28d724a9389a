"""Parity of torch and onnxruntime: exported graphs pass, and graphs with an altered constant do not."""

import numpy as np
import onnx
import pytest
import torch
from onnx import numpy_helper

from service.errors import CazslError, PublishError
from service.model.tensors import ContextKind
from tests.training.publishing.published_graphs import KINDS
from training.networks.methods import METHODS
from training.networks.push_network import PUSH_SHAPES, PushNetwork
from training.publishing.onnx_export import export_onnx
from training.publishing.parity import PARITY_TOLERANCE, check_parity
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
    graphs: dict[ContextKind, bytes], networks: dict[ContextKind, PushNetwork], kind: ContextKind
) -> None:
    """The parity check of an exported graph returns a difference within the tolerance."""
    assert 0.0 <= check_parity(networks[kind], graphs[kind], kind) <= PARITY_TOLERANCE


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
    kind: ContextKind,
    constant: str,
    factor: float,
) -> None:
    """The parity check refuses a graph with one altered constant, of a layer or of the normalisation."""
    graph = with_scaled_constant(graphs[kind], constant, factor)

    # The predictor itself refuses a negative std, before the comparison.
    with pytest.raises(CazslError) as caught:
        check_parity(networks[kind], graph, kind)

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
