"""ONNX export: the interface of the graph, its units, its determinism, and no trace of the machine."""

import math
import sys
from pathlib import Path

import numpy as np
import onnx
import pytest
import torch
from onnx import TensorProto, numpy_helper

import training
from service.model.manifest import MODEL_FILE
from service.model.tensors import ContextKind
from service.registry.registry import Registry
from tests.training.publishing.published_graphs import KINDS, SAME, predict_graph
from training.networks.angles import PushForm
from training.networks.methods import METHODS
from training.networks.omnipush_domain import OmnipushDomain
from training.networks.push_network import PUSH_SHAPES, PushNetwork
from training.omnipush.published import published_normalisation
from training.publishing.onnx_export import export_onnx, strip_origin, wrap_last
from training.publishing.parity import PARITY_TOLERANCE, check_parity
from training.publishing.parity_inputs import extreme_batch, plausible_batch


@pytest.mark.parametrize("kind", KINDS)
def test_the_graph_has_the_interface_of_push_models(graphs: dict[ContextKind, bytes], kind: ContextKind) -> None:
    """The tensors of a graph have the interface's names, order, types and shapes, with free dimensions n and g."""
    graph = onnx.load_from_string(graphs[kind]).graph
    found = [
        (
            tensor.name,
            tensor.type.tensor_type.elem_type,
            [dimension.dim_param or dimension.dim_value for dimension in tensor.type.tensor_type.shape.dim],
        )
        for tensor in (*graph.input, *graph.output)
    ]

    pusher = ("pusher", TensorProto.FLOAT, ["n", 3])
    shape = ["g", 1, 32, 32] if kind is ContextKind.VISUAL else ["g", 36]
    objects = [("context", TensorProto.FLOAT, shape), ("context_index", TensorProto.INT64, ["n"])]
    outputs = [(name, TensorProto.FLOAT, ["n", size]) for name, size in (("mean", 3), ("std", 3), ("unfamiliarity", 2))]
    assert found == [pusher, *([] if kind is ContextKind.NONE else objects), *outputs]


@pytest.mark.parametrize("kind", KINDS)
def test_the_graph_takes_and_gives_si_units(
    graphs: dict[ContextKind, bytes],
    networks: dict[ContextKind, PushNetwork],
    scales: dict[ContextKind, float],
    kind: ContextKind,
) -> None:
    """The graph predicts in metres and radians: the same as torch with normalisation and factor around it."""
    known, batch = published_normalisation(), plausible_batch(kind, pushes=20, objects=5, seed=6)
    pusher = torch.from_numpy(((batch.pusher - known.input_mean) / known.input_std).astype(np.float32))
    context = batch.contexts[0][batch.context_index] if batch.contexts else np.zeros((20, 36), dtype=np.float32)
    with torch.no_grad():
        mean, log_std, _ = networks[kind](pusher[:, None], torch.from_numpy(context))

    found = predict_graph(graphs[kind], kind, batch.pusher, batch.contexts, batch.context_index.tolist())
    assert found[0] == pytest.approx(mean[:, 0].numpy() * known.output_std + known.output_mean, abs=SAME)
    assert found[1] == pytest.approx(np.exp(log_std[:, 0].numpy()) * known.output_std * scales[kind], abs=SAME)


@pytest.mark.parametrize("turns", [-3, -1, 1, 5])
@pytest.mark.parametrize("kind", KINDS)
def test_whole_turns_of_an_input_angle_do_not_matter(
    graphs: dict[ContextKind, bytes], kind: ContextKind, turns: int
) -> None:
    """Whole turns added to an input angle change predictions by no more than float32 rounding."""
    batch = plausible_batch(kind, pushes=50, objects=3, seed=7)
    turned = batch.pusher + np.array([0.0, 0.0, 2.0 * math.pi * turns], dtype=np.float32)

    index = batch.context_index.tolist()
    expected = predict_graph(graphs[kind], kind, batch.pusher, batch.contexts, index)
    assert predict_graph(graphs[kind], kind, turned, batch.contexts, index) == pytest.approx(expected, abs=2e-5)


@pytest.mark.parametrize("kind", KINDS)
def test_predictions_are_gaussians_for_all_inputs(graphs: dict[ContextKind, bytes], kind: ContextKind) -> None:
    """The graph predicts finite means with angles in (-pi, pi] and positive stds, even for extreme inputs."""
    batch = extreme_batch(kind)
    mean, std = predict_graph(graphs[kind], kind, batch.pusher, batch.contexts, batch.context_index.tolist())

    assert np.isfinite(mean).all()
    assert (np.abs(mean[:, 2]) <= np.float32(math.pi)).all()
    assert np.isfinite(std).all()
    assert (std > 0.0).all()


@pytest.mark.parametrize(
    ("angle", "expected"),
    [
        pytest.param(0.0, 0.0, id="zero"),
        pytest.param(math.pi, math.pi, id="pi stays"),
        pytest.param(-math.pi, math.pi, id="minus pi is pi"),
        pytest.param(2.0 * math.pi, 0.0, id="a whole turn"),
        pytest.param(-7.0, -7.0 + 2.0 * math.pi, id="minus seven"),
        pytest.param(100.0, 100.0 - 32.0 * math.pi, id="sixteen turns"),
    ],
)
def test_angles_are_wrapped_and_positions_are_not(angle: float, expected: float) -> None:
    """Wrapping a pose brings its angle into (-pi, pi] and keeps its position."""
    (found,) = wrap_last(torch.tensor([[100.0, -7.0, angle]], dtype=torch.float64)).tolist()

    assert found == pytest.approx([100.0, -7.0, expected], abs=1e-12)


@pytest.mark.parametrize("kind", [ContextKind.INDICATOR, ContextKind.VISUAL])
def test_a_thousand_pushes_share_one_context(graphs: dict[ContextKind, bytes], kind: ContextKind) -> None:
    """A thousand pushes with one context have the same predictions as those pushes one by one."""
    batch = plausible_batch(kind, pushes=1000, objects=1, seed=8)
    together = predict_graph(graphs[kind], kind, batch.pusher, batch.contexts, [0] * 1000)

    assert together.shape == (2, 1000, 3)
    for row in (0, 499, 999):
        alone = predict_graph(graphs[kind], kind, batch.pusher[row : row + 1], batch.contexts, [0])
        assert alone[:, 0] == pytest.approx(together[:, row], abs=SAME)


@pytest.mark.parametrize("kind", [ContextKind.INDICATOR, ContextKind.VISUAL])
def test_a_mixed_batch_is_its_pushes_one_by_one(graphs: dict[ContextKind, bytes], kind: ContextKind) -> None:
    """Each push of a mixed batch is predicted with the context that its index names."""
    batch, index = plausible_batch(kind, pushes=6, objects=4, seed=9), [3, 0, 3, 1, 1, 0]
    together = predict_graph(graphs[kind], kind, batch.pusher, batch.contexts, index)

    for row, which in enumerate(index):
        alone = predict_graph(
            graphs[kind], kind, batch.pusher[row : row + 1], (batch.contexts[0][which : which + 1],), [0]
        )
        assert alone[:, 0] == pytest.approx(together[:, row], abs=SAME)
    same_push = np.repeat(batch.pusher[:1], 4, axis=0)
    assert len(np.unique(predict_graph(graphs[kind], kind, same_push, batch.contexts, [0, 1, 2, 3])[0], axis=0)) == 4


@pytest.mark.parametrize(
    ("kind", "constant"),
    [
        (ContextKind.INDICATOR, "network.context_encoder.weight"),
        (ContextKind.VISUAL, "network.context_encoder.dense.weight"),
    ],
)
def test_the_context_is_encoded_once_per_object(
    graphs: dict[ContextKind, bytes], kind: ContextKind, constant: str
) -> None:
    """The graph encodes g contexts, one row per object, and spreads them over the n pushes afterwards."""
    model = onnx.shape_inference.infer_shapes(onnx.load_from_string(graphs[kind]))
    (layer,) = [node for node in model.graph.node if constant in node.input]
    (shape,) = [value.type.tensor_type.shape for value in model.graph.value_info if value.name == layer.output[0]]

    assert (layer.input[0] == "context") is (kind is ContextKind.INDICATOR)
    assert [dimension.dim_param or dimension.dim_value for dimension in shape.dim] == ["g", 256]


def test_the_same_network_gives_the_same_bytes(
    registry: Registry,
    networks: dict[ContextKind, PushNetwork],
    domains: dict[ContextKind, OmnipushDomain],
    scales: dict[ContextKind, float],
    graphs: dict[ContextKind, bytes],
) -> None:
    """Exporting the same network again gives the same bytes."""
    first, second = (registry.read("push-indicator", version).manifest.files[MODEL_FILE] for version in (1, 2))

    assert first == second
    kind = ContextKind.NONE
    assert export_onnx(networks[kind], kind, domains[kind], scales[kind]) == graphs[kind]


@pytest.mark.parametrize("kind", KINDS)
def test_the_graph_has_no_trace_of_the_machine(graphs: dict[ContextKind, bytes], kind: ContextKind) -> None:
    """The graph contains no folder of the project, of Python or of the user, and no source line."""
    project = Path(training.__file__).parents[1]
    for trace in (str(project), str(Path.cwd()), str(Path.home()), sys.prefix, sys.base_prefix, "site-packages", ".py"):
        assert trace.encode() not in graphs[kind], trace


def test_origins_are_stripped_from_every_part() -> None:
    """Model, graph, nodes, values and constants lose doc strings and metadata, and keep all other fields."""
    constant = numpy_helper.from_array(np.ones(1, dtype=np.float32), "one")
    tensors = [onnx.helper.make_tensor_value_info(name, TensorProto.FLOAT, [1]) for name in ("in", "middle", "out")]
    nodes = [onnx.helper.make_node("Add", ["in", "one"], ["middle"]), onnx.helper.make_node("Neg", ["middle"], ["out"])]
    graph = onnx.helper.make_graph(
        nodes, "graph", [tensors[0]], [tensors[2]], initializer=[constant], value_info=[tensors[1]]
    )
    model = onnx.helper.make_model(graph)
    plain = model.SerializeToString(deterministic=True)
    parts = [model, model.graph, *model.graph.node, *model.graph.initializer]
    parts += [*model.graph.input, *model.graph.output, *model.graph.value_info]
    for part in parts:
        part.doc_string = "line 1 of /somewhere/file"
        entry = part.metadata_props.add()
        entry.key, entry.value = "stack", "/somewhere/file"
    assert model.SerializeToString().count(b"/somewhere") == 2 * len(parts)

    strip_origin(model)

    assert b"/somewhere" not in model.SerializeToString()
    for part in parts:
        part.ClearField("doc_string")  # a text that is there and empty is a field too
    assert model.SerializeToString(deterministic=True) == plain


@pytest.mark.parametrize("form", [PushForm.CIRCULAR, PushForm.PUSH_FRAME])
@pytest.mark.parametrize("kind", KINDS)
def test_options_beyond_the_paper_are_part_of_the_graph(kind: ContextKind, form: PushForm) -> None:
    """Form and least std are inside the graph. Poses have three numbers, and means do not jump at pi."""
    torch.manual_seed(13)
    method = METHODS["FCN" if kind is ContextKind.NONE else "FCN + CM"]
    network = PushNetwork(method, PUSH_SHAPES[kind], form, least_std=0.02)
    batch = plausible_batch(kind, 2, 32)
    for context in batch.contexts:
        network.conditioning(torch.from_numpy(context))
    graph = export_onnx(network.eval(), kind)
    seam = np.array([(0.08, 0.01, math.pi - 1e-5), (0.08, 0.01, 1e-5 - math.pi)], dtype=np.float32)
    found = predict_graph(graph, kind, seam, tuple(tensor[:1] for tensor in batch.contexts), [0, 0])

    assert check_parity(network, graph, kind) <= PARITY_TOLERANCE
    assert found[:, 0] == pytest.approx(found[:, 1], abs=1e-5)
    assert (found[1] > 0.02 * published_normalisation().output_std * 0.999).all()
