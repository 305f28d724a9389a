"""Publication: the manifest, the served version, and refusals before any version becomes visible."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from service.errors import CazslError, DataError, PublishError
from service.inference.loaded_models import LoadedModels
from service.inference.query import ContextBatch, predict
from service.model.predictor import OnnxPredictor
from service.model.reference import ModelReference
from service.model.tensors import ContextKind
from service.pushing.contexts import ObjectContext, VisualContext
from service.pushing.gates import PUSHING
from service.registry.loading import load_version
from service.registry.promotion import judge
from service.registry.registry import Registry
from tests.training.publishing.published_graphs import KINDS, SAME, load_push_network
from training.fitting.bands import calibrated
from training.fitting.evaluation import evaluate
from training.fitting.recipe import Recipe
from training.fitting.run_folder import load_run
from training.fitting.samples import Samples, TrainingData
from training.fitting.training_loop import fit
from training.networks.methods import METHODS
from training.networks.push_network import PUSH_SHAPES, PushNetwork
from training.omnipush.published import published_normalisation
from training.omnipush.pushes import Pushes
from training.publishing.publish import publish


@pytest.mark.parametrize("kind", KINDS)
def test_a_published_version_is_verified_and_served(
    registry: Registry, networks: dict[ContextKind, PushNetwork], kind: ContextKind
) -> None:
    """The service verifies and loads a published version, and predicts the same Gaussian as torch."""
    loaded = LoadedModels(registry, OnnxPredictor)
    loaded.refresh()
    model = loaded.snapshot.find(ModelReference(f"push-{kind}", None, 1))
    context: ObjectContext | VisualContext = ObjectContext.from_descriptor("1a2b3c4a")
    if kind is ContextKind.VISUAL:
        context = VisualContext.from_bytes(bytes(range(256)) * 4)
    contexts = ContextBatch(kind, (), None, "body")
    if kind is not ContextKind.NONE:
        contexts = ContextBatch(kind, (context.tensor()[None],), np.zeros(1, dtype=np.int64), "body")
    found_mean, found_std, unfamiliarity = predict(model, np.array([[-0.075, 0.01, 0.1]], dtype=np.float32), contexts)

    known = published_normalisation()
    pusher = (np.array([-0.075, 0.01, 0.1]) - known.input_mean) / known.input_std
    with torch.no_grad():
        mean, log_std, _ = networks[kind](
            torch.tensor(pusher, dtype=torch.float32)[None, None], torch.from_numpy(context.tensor())[None]
        )
    expected_mean = mean[0, 0].numpy() * known.output_std + known.output_mean
    scale = model.manifest.calibration["different-objects"].scale
    assert scale is not None
    expected_std = np.exp(log_std[0, 0].numpy()) * known.output_std * scale
    assert loaded.snapshot.problems == ()
    assert found_mean[0] == pytest.approx(expected_mean, abs=SAME)
    assert found_std[0] == pytest.approx(expected_std, abs=SAME)
    assert unfamiliarity is not None
    assert unfamiliarity.shape == (1, 2)


def test_publishing_again_gives_the_next_version(registry: Registry) -> None:
    """Versions count up, every one of them is verified, and publishing moves no alias."""
    assert registry.names() == ["push-indicator", "push-none", "push-visual"]
    assert registry.versions("push-indicator") == [1, 2]
    assert [registry.read("push-indicator", version).manifest.version for version in (1, 2)] == [1, 2]
    assert registry.aliases("push-indicator") == {}


@pytest.mark.parametrize("kind", KINDS)
def test_the_manifest_records_recipe_data_and_figures(
    registry: Registry, data: dict[ContextKind, Pushes], runs: dict[ContextKind, Path], kind: ContextKind
) -> None:
    """The manifest records the run's recipe, data and split, and the figures on its held-out objects."""
    recipe, network, _ = load_run(runs[kind])
    split, pushes = recipe.split(), data[kind]
    held_out = pushes.select(split.test)
    assert isinstance(network, PushNetwork)
    calibrated_figures = calibrated(network, Samples.of(held_out, kind))
    figures = calibrated_figures.predictions[""].measures()
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
    assert calibration.scale == calibrated_figures.factor
    assert [calibration.regions_50, calibration.regions_90, calibration.regions_95] == calibrated_figures.predictions[
        ""
    ].regions()
    assert found.validity is not None
    assert "start_distance_m" in found.validity.ranges
    assert found.normalisation.output_std == published_normalisation().output_std.tolist()
    assert found.image_convention == ("noise of a test" if kind is ContextKind.VISUAL else None)


def test_data_without_the_split_are_refused(pushes: Pushes, indicator_run: Path, tmp_path: Path) -> None:
    """Publishing with data that lack held-out objects is refused, and no version becomes visible."""
    recipe, network, _ = load_run(indicator_run)

    with pytest.raises(DataError, match="missing from the data"):
        publish(recipe, network, pushes.select(recipe.split().train), Registry(tmp_path / "models"))

    assert not (tmp_path / "models").exists()


def test_a_network_that_diverged_is_not_published(pushes: Pushes, none_run: Path, tmp_path: Path) -> None:
    """Publishing a network with weights that are not finite is refused, and no version becomes visible."""
    recipe, network = load_run(none_run)[0], load_push_network(none_run)
    with torch.no_grad():
        network.third.weight[0, 0] = math.nan

    with pytest.raises(CazslError):
        publish(replace(recipe, name="diverged"), network, pushes, Registry(tmp_path / "models"))

    assert not (tmp_path / "models").exists()


class UnrepeatableNetwork(PushNetwork):
    """A network that never gives the same output twice, so no graph can agree with it."""

    def __init__(self) -> None:
        super().__init__(METHODS["FCN"], PUSH_SHAPES[ContextKind.NONE])
        self.calls = 0

    def gaussian(self, pusher: torch.Tensor, conditioning: torch.Tensor | None) -> tuple[torch.Tensor, torch.Tensor]:
        """Predict a Gaussian that moves further to the right with every call."""
        self.calls += 1
        mean, log_std = super().gaussian(pusher, conditioning)
        return mean + 0.1 * self.calls, log_std


def test_a_graph_that_disagrees_with_its_network_is_not_published(
    pushes: Pushes, none_run: Path, tmp_path: Path
) -> None:
    """Publishing a graph that fails the parity check is refused, and no version becomes visible."""
    recipe, _, _ = load_run(none_run)

    with pytest.raises(PublishError, match="onnxruntime differs from torch"):
        publish(recipe, UnrepeatableNetwork(), pushes, Registry(tmp_path / "models"))

    assert not (tmp_path / "models").exists()


def test_a_visual_version_has_a_self_check_with_held_out_views(
    registry: Registry, viewed_pushes: Pushes, recipe: Recipe
) -> None:
    """The self-check of a visual version, which the gates turn, has views of held-out objects instead of noise."""
    check = registry.read("push-visual", 1).manifest.self_check
    views = viewed_pushes.select(recipe.split().test[:2]).views
    assert views is not None

    assert np.array(check.context, dtype=np.float32) == pytest.approx(views.reshape(2, -1) / np.float32(255.0))


def test_a_model_of_all_objects_has_figures_of_a_held_out_run(
    recipe: Recipe, pushes: Pushes, networks: dict[ContextKind, PushNetwork], tmp_path: Path
) -> None:
    """Manifest and card of a model of all objects name both its own set-up and that of the measured run."""
    everything, judging = replace(recipe, set_up="all-objects"), networks[ContextKind.INDICATOR]
    network = fit(
        everything, TrainingData.of(everything.split(), ContextKind.INDICATOR, pushes), tmp_path / "run", True
    )
    assert isinstance(network, PushNetwork)
    store = Registry(tmp_path / "models")
    found = publish(everything, network, pushes, store, measured=(recipe, judging))
    figures = evaluate(judging, Samples.of(pushes.select(recipe.split().test), ContextKind.INDICATOR))
    card = store.read(found.name, 1).card

    assert (found.data.split, found.data.train_objects, found.data.held_out_objects) == ("all-objects", 250, 50)
    assert {name: metrics.rmse for name, metrics in found.metrics.items()} == {"different-objects": figures.rmse}
    assert list(found.calibration) == ["different-objects"]
    assert "split `all-objects`" in card
    assert "recipe trained on `different-objects` and measured there" in card


@pytest.mark.parametrize(
    ("change", "message"),
    [
        pytest.param({"set_up": "all-objects"}, "no held-out objects to measure", id="all objects again"),
        pytest.param({"epochs": 2}, "of another recipe; only set_up may differ", id="another recipe"),
        pytest.param({"set_up": "different-surfaces"}, "is not published", id="another surface"),
    ],
)
def test_figures_of_an_unsuitable_run_are_refused(
    recipe: Recipe,
    pushes: Pushes,
    networks: dict[ContextKind, PushNetwork],
    tmp_path: Path,
    change: dict[str, Any],
    message: str,
) -> None:
    """A measured run must have the same recipe on objects held out of the same surface, or publishing is refused."""
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
    """Publishing a neural process is refused, because it needs pushes of the object that no client has."""
    process = replace(recipe, name="anp", method="ANP", context="none", epochs=1)
    network = fit(process, TrainingData.of(process.split(), ContextKind.NONE, pushes), tmp_path / "run", quiet=True)

    with pytest.raises(DataError, match="ANP on different-objects is not published"):
        publish(process, network, pushes, Registry(tmp_path / "models"))

    assert not (tmp_path / "models").exists()


def test_the_champion_is_measured_on_the_data_of_the_new_version(
    pushes: Pushes, none_run: Path, tmp_path: Path
) -> None:
    """The manifest of a new version has the champion's figures on the same held-out pushes, for the gates."""
    recipe, network, _ = load_run(none_run)
    store = Registry(tmp_path / "models")
    first = publish(recipe, network, pushes, store)
    store.point_alias(recipe.name, "champion", 1)
    other = replace(pushes, digest="0" * 64)
    second = publish(recipe, network, other, store)

    assert first.rivals is None
    assert second.rivals is not None
    assert second.rivals["1"].metrics["different-objects"].rmse == pytest.approx(
        first.metrics["different-objects"].rmse, abs=1e-5
    )
    verdicts = judge(
        load_version(store, OnnxPredictor, recipe.name, 2), load_version(store, OnnxPredictor, recipe.name, 1), PUSHING
    )
    assert {"nll", "coverage"} <= {verdict.gate for verdict in verdicts}
    assert "held-out" not in {verdict.gate for verdict in verdicts}
