"""From torch to a published version: the contract's graph, parity, and nothing visible that was not checked."""

import math
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest
import torch
from onnx import TensorProto, numpy_helper

import training
from service.errors import CazslError, DataError, PublishError
from service.inference.loaded_models import LoadedModels
from service.model.manifest import MODEL_FILE
from service.model.predictor import OnnxPredictor
from service.model.reference import ModelReference
from service.model.tensors import ContextKind, FloatArray
from service.pushing.contexts import ObjectContext, VisualContext
from service.pushing.poses import Pose
from service.registry.registry import Registry
from training.fitting.evaluation import evaluate
from training.fitting.recipe import Recipe
from training.fitting.run_folder import load_run
from training.fitting.samples import Samples, TrainingData
from training.fitting.training_loop import fit
from training.networks.methods import METHODS
from training.networks.push_network import PUSH_SHAPES, PushNetwork
from training.omnipush.published import published_normalisation
from training.omnipush.pushes import Pushes, read_folder
from training.publishing.onnx_export import export_onnx, strip_origin, wrap_last
from training.publishing.parity import PARITY_TOLERANCE, check_parity
from training.publishing.parity_inputs import extreme_batch, probe_batch
from training.publishing.publish import publish

KINDS = [ContextKind.INDICATOR, ContextKind.NONE, ContextKind.VISUAL]
# float32 in metres and radians: what another order of sums may leave
SAME = 1e-6


@pytest.fixture(scope="module")
def pushes(data_folder: Path) -> Pushes:
    """The synthetic pushes of all 250 objects."""
    return read_folder(data_folder)


@pytest.fixture(scope="module")
def data(pushes: Pushes, viewed_pushes: Pushes) -> dict[ContextKind, Pushes]:
    """What each kind was fitted to."""
    return {kind: viewed_pushes if kind is ContextKind.VISUAL else pushes for kind in KINDS}


@pytest.fixture(scope="module")
def runs(indicator_run: Path, none_run: Path, visual_run: Path) -> dict[ContextKind, Path]:
    """The finished run of each kind."""
    return {ContextKind.INDICATOR: indicator_run, ContextKind.NONE: none_run, ContextKind.VISUAL: visual_run}


def fitted(run: Path) -> PushNetwork:
    """The network of a run, which is one to serve."""
    network = load_run(run)[1]
    assert isinstance(network, PushNetwork)
    return network


@pytest.fixture(scope="module")
def networks(runs: dict[ContextKind, Path]) -> dict[ContextKind, PushNetwork]:
    """The fitted network of each kind."""
    return {kind: fitted(run) for kind, run in runs.items()}


@pytest.fixture(scope="module")
def registry(
    tmp_path_factory: pytest.TempPathFactory, data: dict[ContextKind, Pushes], runs: dict[ContextKind, Path]
) -> Registry:
    """A registry in which the indicator model was published twice and the others once; not to be changed."""
    found = Registry(tmp_path_factory.mktemp("registry") / "models")
    for kind in (ContextKind.INDICATOR, *runs):
        recipe, network, _ = load_run(runs[kind])
        publish(recipe, network, data[kind], found, "noise of a test" if kind is ContextKind.VISUAL else None)
    return found


@pytest.fixture(scope="module")
def graphs(registry: Registry) -> dict[ContextKind, bytes]:
    """The published graph of each kind."""
    return {kind: registry.read(f"push-{kind}", 1).model for kind in KINDS}


def predicted(graph: bytes, kind: ContextKind, pusher: FloatArray, context: FloatArray, index: list[int]) -> FloatArray:
    """Mean and std, (2, n, 3)."""
    return np.stack(OnnxPredictor(graph, kind).predict(pusher, context, np.array(index, dtype=np.int64)))


def with_initializer(graph: bytes, name: str, factor: float) -> bytes:
    """The same graph with one of its constants multiplied."""
    model = onnx.load_from_string(graph)
    (tensor,) = [tensor for tensor in model.graph.initializer if tensor.name == name]
    tensor.CopyFrom(numpy_helper.from_array(numpy_helper.to_array(tensor) * np.float32(factor), name))
    return bytes(model.SerializeToString())


@pytest.mark.parametrize("kind", KINDS)
def test_the_graph_has_exactly_the_contract_s_tensors(graphs: dict[ContextKind, bytes], kind: ContextKind) -> None:
    """Names, order, types and shapes; a text is a free dimension."""
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
    outputs = [("mean", TensorProto.FLOAT, ["n", 3]), ("std", TensorProto.FLOAT, ["n", 3])]
    assert found == [pusher, *([] if kind is ContextKind.NONE else objects), *outputs]


@pytest.mark.parametrize("kind", KINDS)
def test_onnxruntime_agrees_with_torch(
    graphs: dict[ContextKind, bytes], networks: dict[ContextKind, PushNetwork], kind: ContextKind
) -> None:
    """The check passes for the graph that was exported, and says how close the two are."""
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
    """One altered constant, of a layer or of the normalisation, is enough."""
    graph = with_initializer(graphs[kind], constant, factor)

    # a negative std is refused by the predictor itself, before it could be compared
    with pytest.raises(CazslError) as caught:
        check_parity(networks[kind], graph, kind)

    assert isinstance(caught.value, PublishError) or (constant, factor) == ("output_std", -1.0)


@pytest.mark.parametrize("kind", KINDS)
def test_the_graph_takes_and_gives_si_units(
    graphs: dict[ContextKind, bytes], networks: dict[ContextKind, PushNetwork], kind: ContextKind
) -> None:
    """Metres and radians go in and come out: the published normalisation, done by hand around torch, gives the same."""
    known, batch = published_normalisation(), probe_batch(kind, pushes=20, objects=5, seed=6)
    pusher = torch.from_numpy(((batch.pusher - known.input_mean) / known.input_std).astype(np.float32))
    with torch.no_grad():
        mean, log_std, _ = networks[kind](pusher[:, None], torch.from_numpy(batch.context[batch.context_index]))

    found = predicted(graphs[kind], kind, batch.pusher, batch.context, batch.context_index.tolist())
    assert found[0] == pytest.approx(mean[:, 0].numpy() * known.output_std + known.output_mean, abs=SAME)
    assert found[1] == pytest.approx(np.exp(log_std[:, 0].numpy()) * known.output_std, abs=SAME)


@pytest.mark.parametrize("turns", [-3, -1, 1, 5])
@pytest.mark.parametrize("kind", KINDS)
def test_an_angle_and_whole_turns_more_are_the_same_push(
    graphs: dict[ContextKind, bytes], kind: ContextKind, turns: int
) -> None:
    """Angles going in may be any real number; float32 leaves a microradian per turn."""
    batch = probe_batch(kind, pushes=50, objects=3, seed=7)
    turned = batch.pusher + np.array([0.0, 0.0, 2.0 * math.pi * turns], dtype=np.float32)

    index = batch.context_index.tolist()
    expected = predicted(graphs[kind], kind, batch.pusher, batch.context, index)
    assert predicted(graphs[kind], kind, turned, batch.context, index) == pytest.approx(expected, abs=2e-5)


@pytest.mark.parametrize("kind", KINDS)
def test_the_graph_s_answers_are_gaussians_everywhere(graphs: dict[ContextKind, bytes], kind: ContextKind) -> None:
    """However far the input, means are finite with angles in (-pi, pi] and deviations are positive."""
    batch = extreme_batch(kind)
    mean, std = predicted(graphs[kind], kind, batch.pusher, batch.context, batch.context_index.tolist())

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
    """The last of the three numbers comes into (-pi, pi]; the first two pass, whatever their size."""
    (found,) = wrap_last(torch.tensor([[100.0, -7.0, angle]], dtype=torch.float64)).tolist()

    assert found == pytest.approx([100.0, -7.0, expected], abs=1e-12)


@pytest.mark.parametrize("kind", [ContextKind.INDICATOR, ContextKind.VISUAL])
def test_many_pushes_of_one_object_are_those_pushes_one_by_one(
    graphs: dict[ContextKind, bytes], kind: ContextKind
) -> None:
    """One context serves a thousand pushes."""
    batch = probe_batch(kind, pushes=1000, objects=1, seed=8)
    together = predicted(graphs[kind], kind, batch.pusher, batch.context, [0] * 1000)

    assert together.shape == (2, 1000, 3)
    for row in (0, 499, 999):
        alone = predicted(graphs[kind], kind, batch.pusher[row : row + 1], batch.context, [0])
        assert alone[:, 0] == pytest.approx(together[:, row], abs=SAME)


@pytest.mark.parametrize("kind", [ContextKind.INDICATOR, ContextKind.VISUAL])
def test_a_mixed_batch_is_its_pushes_one_by_one(graphs: dict[ContextKind, bytes], kind: ContextKind) -> None:
    """Every push meets the object that its index names, whatever the order and whoever is left out."""
    batch, index = probe_batch(kind, pushes=6, objects=4, seed=9), [3, 0, 3, 1, 1, 0]
    together = predicted(graphs[kind], kind, batch.pusher, batch.context, index)

    for row, which in enumerate(index):
        alone = predicted(graphs[kind], kind, batch.pusher[row : row + 1], batch.context[which : which + 1], [0])
        assert alone[:, 0] == pytest.approx(together[:, row], abs=SAME)
    same_push = np.repeat(batch.pusher[:1], 4, axis=0)
    assert len(np.unique(predicted(graphs[kind], kind, same_push, batch.context, [0, 1, 2, 3])[0], axis=0)) == 4


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
    """The mask's layer has a row per object, g of them, and is spread over the n pushes afterwards."""
    model = onnx.shape_inference.infer_shapes(onnx.load_from_string(graphs[kind]))
    (layer,) = [node for node in model.graph.node if constant in node.input]
    (shape,) = [value.type.tensor_type.shape for value in model.graph.value_info if value.name == layer.output[0]]

    assert (layer.input[0] == "context") is (kind is ContextKind.INDICATOR)
    assert [dimension.dim_param or dimension.dim_value for dimension in shape.dim] == ["g", 256]


def test_the_same_network_gives_the_same_bytes(
    registry: Registry, networks: dict[ContextKind, PushNetwork], graphs: dict[ContextKind, bytes]
) -> None:
    """Exporting again, published or not, changes nothing in the graph."""
    first, second = (registry.read("push-indicator", version).manifest.files[MODEL_FILE] for version in (1, 2))

    assert first == second
    assert export_onnx(networks[ContextKind.NONE], ContextKind.NONE) == graphs[ContextKind.NONE]


@pytest.mark.parametrize("kind", KINDS)
def test_the_graph_has_no_trace_of_the_machine(graphs: dict[ContextKind, bytes], kind: ContextKind) -> None:
    """No folder of the project, of Python or of the user, no source line."""
    project = Path(training.__file__).parents[1]
    for trace in (str(project), str(Path.cwd()), str(Path.home()), sys.prefix, sys.base_prefix, "site-packages", ".py"):
        assert trace.encode() not in graphs[kind], trace


def test_origins_are_stripped_wherever_they_may_stand() -> None:
    """Model, graph, nodes, values and constants lose texts and metadata and keep everything else."""
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


@pytest.mark.parametrize("kind", KINDS)
def test_a_published_version_is_verified_and_served(
    registry: Registry, networks: dict[ContextKind, PushNetwork], kind: ContextKind
) -> None:
    """The service's own code reads it, runs its self-check, and predicts what torch predicts."""
    loaded = LoadedModels(registry, OnnxPredictor)
    loaded.refresh()
    model = loaded.snapshot.find(ModelReference(f"push-{kind}", None, 1))
    thing: ObjectContext | VisualContext = ObjectContext.from_descriptor("1a2b3c4a")
    if kind is ContextKind.VISUAL:
        thing = VisualContext.from_bytes(bytes(range(256)) * 4)
    gaussian = model.predict_push(Pose(-0.075, 0.01, 0.1), None if kind is ContextKind.NONE else thing)

    known = published_normalisation()
    pusher = (np.array([-0.075, 0.01, 0.1]) - known.input_mean) / known.input_std
    with torch.no_grad():
        mean, log_std, _ = networks[kind](
            torch.tensor(pusher, dtype=torch.float32)[None, None], torch.from_numpy(thing.tensor())[None]
        )
    expected_mean = mean[0, 0].numpy() * known.output_std + known.output_mean
    expected_std = np.exp(log_std[0, 0].numpy()) * known.output_std
    assert loaded.snapshot.problems == ()
    assert (gaussian.mean.x_m, gaussian.mean.y_m, gaussian.mean.angle_rad) == pytest.approx(expected_mean, abs=SAME)
    assert (gaussian.std.x_m, gaussian.std.y_m, gaussian.std.angle_rad) == pytest.approx(expected_std, abs=SAME)


def test_publishing_again_gives_the_next_version(registry: Registry) -> None:
    """Versions count up and every one is verified; no alias moves by itself."""
    assert registry.names() == ["push-indicator", "push-none", "push-visual"]
    assert registry.versions("push-indicator") == [1, 2]
    assert [registry.read("push-indicator", version).manifest.version for version in (1, 2)] == [1, 2]
    assert registry.aliases("push-indicator") == {}


@pytest.mark.parametrize("kind", KINDS)
def test_the_manifest_says_what_the_model_is(
    registry: Registry, data: dict[ContextKind, Pushes], runs: dict[ContextKind, Path], kind: ContextKind
) -> None:
    """Recipe, data, split and figures are those of the run, measured on the held-out objects."""
    recipe, network, _ = load_run(runs[kind])
    split, pushes = recipe.split(), data[kind]
    held_out = pushes.select(split.test)
    figures = evaluate(network, Samples.of(held_out, kind))
    found = registry.read(f"push-{kind}", 1).manifest

    assert (found.name, found.method, found.context_kind) == (f"push-{kind}", recipe.method, kind)
    assert found.recipe == recipe.record()
    assert (found.data.source, found.data.sha256, found.data.split) == (pushes.source, pushes.digest, split.name)
    assert (found.data.train_objects, found.data.held_out_objects) == (200, 50)
    assert (found.data.train_pushes, found.data.held_out_pushes) == (
        pushes.select(split.train).count,
        held_out.count,
    )
    assert vars(found.metrics[split.name]) == pytest.approx(
        {"rmse": figures.rmse, "std": figures.std, "distance_mm": figures.distance_mm, "nll": figures.nll}
    )
    calibration = found.calibration[split.name]
    assert (calibration.coverage_50, calibration.coverage_90, calibration.coverage_95) == tuple(
        figures.coverage.values()
    )
    assert calibration.sharpness == pytest.approx(figures.sharpness)
    assert found.normalisation.output_std == published_normalisation().output_std.tolist()
    assert found.image_convention == ("noise of a test" if kind is ContextKind.VISUAL else None)


@pytest.mark.parametrize("kind", KINDS)
def test_the_card_names_its_data_and_figures(
    registry: Registry, data: dict[ContextKind, Pushes], kind: ContextKind
) -> None:
    """Nobody who reads the card can take the data for other data, or the figures for other figures."""
    pushes, version = data[kind], registry.read(f"push-{kind}", 1)
    metrics = version.manifest.metrics["different-objects"]

    assert f"Trained on **{pushes.source}**: 200 objects" in version.card
    assert pushes.digest in version.card
    assert f"| {metrics.rmse:.4f} | {metrics.std:.4f} | {metrics.distance_mm:.2f} | {metrics.nll:.3f} |" in version.card
    assert "80 to 80 mm" in version.card


def test_data_without_the_split_publish_nothing(pushes: Pushes, indicator_run: Path, tmp_path: Path) -> None:
    """A model is measured on all held-out objects or not published."""
    recipe, network, _ = load_run(indicator_run)

    with pytest.raises(DataError, match="missing from the data"):
        publish(recipe, network, pushes.select(recipe.split().train), Registry(tmp_path / "models"))

    assert not (tmp_path / "models").exists()


def test_a_network_that_diverged_is_not_published(pushes: Pushes, none_run: Path, tmp_path: Path) -> None:
    """Weights that are no numbers give no Gaussians, and nothing becomes visible."""
    recipe, network = load_run(none_run)[0], fitted(none_run)
    with torch.no_grad():
        network.third.weight[0, 0] = math.nan

    with pytest.raises(CazslError):
        publish(replace(recipe, name="diverged"), network, pushes, Registry(tmp_path / "models"))

    assert not (tmp_path / "models").exists()


class Restless(PushNetwork):
    """A network that never gives the same answer twice: no graph can agree with it."""

    def __init__(self) -> None:
        super().__init__(METHODS["FCN"], PUSH_SHAPES[ContextKind.NONE])
        self.calls = 0

    def gaussian(self, pusher: torch.Tensor, conditioning: torch.Tensor | None) -> tuple[torch.Tensor, torch.Tensor]:
        """The Gaussian, further to the right with every call."""
        self.calls += 1
        mean, log_std = super().gaussian(pusher, conditioning)
        return mean + 0.1 * self.calls, log_std


def test_a_graph_that_disagrees_with_its_network_is_not_published(
    pushes: Pushes, none_run: Path, tmp_path: Path
) -> None:
    """Parity is checked before anything becomes visible."""
    recipe, _, _ = load_run(none_run)

    with pytest.raises(PublishError, match="onnxruntime differs from torch"):
        publish(recipe, Restless(), pushes, Registry(tmp_path / "models"))

    assert not (tmp_path / "models").exists()


METHOD_CELLS = [(name, kind) for name, method in METHODS.items() for kind in ContextKind if method.takes(kind)]


@pytest.mark.parametrize(("name", "kind"), [cell for cell in METHOD_CELLS if cell[0] != "ANP"])
def test_every_served_method_becomes_a_graph_that_agrees_with_it(name: str, kind: ContextKind) -> None:
    """Whatever the method and its context: exported in eval mode, checked on plausible and extreme inputs."""
    torch.manual_seed(12)
    network = PushNetwork(METHODS[name], PUSH_SHAPES[kind])
    context = torch.from_numpy(probe_batch(kind, 1, 32).context)
    network.conditioning(context)  # a batch in training, so that the batch norms have something on record
    graph = export_onnx(network, kind)

    assert check_parity(network, graph, kind) <= PARITY_TOLERANCE
    assert b"distance" not in graph, "what only the training needs is not served"


def test_a_visual_version_carries_views_of_objects_that_it_has_not_seen(
    registry: Registry, viewed_pushes: Pushes, recipe: Recipe
) -> None:
    """Its self-check and the gate that turns them are about objects, not about noise."""
    check = registry.read("push-visual", 1).manifest.self_check
    views = viewed_pushes.select(recipe.split().test[:2]).views
    assert views is not None

    assert np.array(check.context, dtype=np.float32) == pytest.approx(views.reshape(2, -1) / np.float32(255.0))


@pytest.mark.parametrize("kind", KINDS)
def test_a_network_beyond_the_paper_becomes_a_graph_that_agrees_with_it(kind: ContextKind) -> None:
    """Circular angle and least std are inside the graph, which still takes poses of three numbers; pi has no seam."""
    torch.manual_seed(13)
    method = METHODS["FCN" if kind is ContextKind.NONE else "FCN + CM"]
    network = PushNetwork(method, PUSH_SHAPES[kind], circular_angle=True, least_std=0.02)
    batch = probe_batch(kind, 2, 32)
    network.conditioning(torch.from_numpy(batch.context))
    graph = export_onnx(network.eval(), kind)
    seam = np.array([(0.08, 0.01, math.pi - 1e-5), (0.08, 0.01, 1e-5 - math.pi)], dtype=np.float32)
    found = predicted(graph, kind, seam, batch.context[:1], [0, 0])

    assert check_parity(network, graph, kind) <= PARITY_TOLERANCE
    assert found[:, 0] == pytest.approx(found[:, 1], abs=1e-5)
    assert (found[1] > 0.02 * published_normalisation().output_std * 0.999).all()


def test_a_model_of_all_objects_carries_the_figures_of_one_that_held_some_out(
    recipe: Recipe, pushes: Pushes, networks: dict[ContextKind, PushNetwork], tmp_path: Path
) -> None:
    """Manifest and card name both set-ups: what it was trained on, and where the figures come from."""
    everything, judge = replace(recipe, set_up="all-objects"), networks[ContextKind.INDICATOR]
    network = fit(
        everything, TrainingData.of(everything.split(), ContextKind.INDICATOR, pushes), tmp_path / "run", True
    )
    assert isinstance(network, PushNetwork)
    store = Registry(tmp_path / "models")
    found = publish(everything, network, pushes, store, measured=(recipe, judge))
    figures = evaluate(judge, Samples.of(pushes.select(recipe.split().test), ContextKind.INDICATOR))
    card = store.read(found.name, 1).card

    assert (found.data.split, found.data.train_objects, found.data.held_out_objects) == ("all-objects", 250, 50)
    assert {name: metrics.rmse for name, metrics in found.metrics.items()} == {"different-objects": figures.rmse}
    assert list(found.calibration) == ["different-objects"]
    assert "split `all-objects`" in card
    assert "recipe trained on `different-objects` and measured there" in card


@pytest.mark.parametrize(
    ("change", "message"),
    [
        pytest.param({"set_up": "all-objects"}, "no figure of its own would be honest", id="all objects again"),
        pytest.param({"epochs": 2}, "of another recipe; only set_up may differ", id="another recipe"),
        pytest.param({"set_up": "different-surfaces"}, "is not published", id="another surface"),
    ],
)
def test_figures_are_not_borrowed_from_just_any_run(
    recipe: Recipe,
    pushes: Pushes,
    networks: dict[ContextKind, PushNetwork],
    tmp_path: Path,
    change: dict[str, Any],
    message: str,
) -> None:
    """Only the same recipe on objects held out of the same surface speaks for a model; nothing is published."""
    network = networks[ContextKind.INDICATOR]

    with pytest.raises(DataError, match=message):
        publish(
            replace(recipe, set_up="all-objects"),
            network,
            pushes,
            Registry(tmp_path / "models"),
            measured=(replace(recipe, **change), network),
        )

    assert not (tmp_path / "models").exists()


def test_a_neural_process_is_not_published(recipe: Recipe, pushes: Pushes, tmp_path: Path) -> None:
    """It needs pushes of the very object, which no caller of the service has."""
    process = replace(recipe, name="anp", method="ANP", context="none", epochs=1)
    network = fit(process, TrainingData.of(process.split(), ContextKind.NONE, pushes), tmp_path / "run", quiet=True)

    with pytest.raises(DataError, match="ANP on different-objects is not published"):
        publish(process, network, pushes, Registry(tmp_path / "models"))

    assert not (tmp_path / "models").exists()
