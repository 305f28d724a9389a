"""Publication of networks of shapes: the version is served, its figures are held out, and refusals come before it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from service.errors import DataError, PublishError
from service.inference.loaded_models import LoadedModels
from service.model.predictor import OnnxPredictor
from service.model.reference import ModelReference
from service.model.tensors import ContextKind
from service.pushing.gates import PUSHING
from service.pushing.shape_context import ShapeContext
from service.registry.loading import load_version
from service.registry.promotion import judge
from service.registry.registry import Registry
from tests.served_graphs import BOX, L_SHAPE, shape_tensors
from tests.training.publishing.published_graphs import load_push_network
from training.fitting.recipe import ALL_FAMILIES, Recipe
from training.fitting.run_folder import load_run
from training.fitting.shape_evaluation import SEEN, UNSEEN, evaluate_shapes
from training.fitting.shape_samples import split_shapes
from training.networks.push_network import PushNetwork
from training.networks.shape_network import ShapeNetwork
from training.publishing.shape_publish import publish_shapes
from training.tables.push_table import PushTable
from training.tables.reading import read_table


@pytest.fixture(scope="module")
def table(shapes_folder: Path) -> PushTable:
    """Read the small table of shapes."""
    return read_table(shapes_folder)


@pytest.fixture(scope="module")
def network(shape_run: Path) -> PushNetwork:
    """Load the fitted network of shapes."""
    return load_push_network(shape_run)


@pytest.fixture(scope="module")
def store(
    tmp_path_factory: pytest.TempPathFactory, shape_recipe: Recipe, network: PushNetwork, table: PushTable
) -> Registry:
    """Publish a version of all families with the figures of a measured run. Tests must not change this registry."""
    found = Registry(tmp_path_factory.mktemp("shapes") / "models")
    everything = replace(shape_recipe, set_up=ALL_FAMILIES)
    publish_shapes(everything, network, table, found, (shape_recipe, network), "## Recorded pushes\n\nscored elsewhere")
    return found


def test_a_published_version_is_served_as_torch_predicts(store: Registry, network: PushNetwork) -> None:
    """The service verifies and loads the version, whose answers are those of torch, with the factor on std."""
    loaded = LoadedModels(store, OnnxPredictor)
    loaded.refresh()
    model = loaded.snapshot.find(ModelReference("push-shape", None, 1))
    pusher = np.array([[-0.2, 0.005, 0.02, 0.2], [0.15, 0.02, -3.0, 0.05]], dtype=np.float32)
    contexts, index = shape_tensors(ShapeContext(BOX), ShapeContext(L_SHAPE)), np.array([0, 1])
    mean, std, unfamiliarity = model.predictor.predict(pusher, contexts, index)
    scale = model.manifest.calibration[SEEN].scale
    assert scale is not None
    served = ShapeNetwork(network, scale=scale).eval()  # both objects are too large for a wider one
    with torch.inference_mode():
        expected = served(*(torch.from_numpy(part) for part in (pusher, *contexts, index)))
    assert loaded.snapshot.problems == ()
    assert mean == pytest.approx(expected[0].numpy(), abs=1e-4)
    assert std == pytest.approx(expected[1].numpy(), abs=1e-4)
    assert unfamiliarity is not None
    assert unfamiliarity.shape == (2, 2)


def test_a_version_keeps_the_laws_of_pushing(store: Registry) -> None:
    """The gates of physics pass before a word is said about accuracy: misses, mirrors, turns and scale."""
    verdicts = judge(load_version(store, OnnxPredictor, "push-shape", 1), None, PUSHING)
    physics = [verdict for verdict in verdicts if verdict.gate not in {"held-out", "nll", "coverage"}]
    assert len(physics) >= 5
    assert [verdict for verdict in physics if not verdict.passed] == []


def test_the_manifest_has_the_figures_of_the_measured_run(
    store: Registry, shape_recipe: Recipe, network: PushNetwork, table: PushTable
) -> None:
    """Nothing is held out of a version of all families, so its figures are of the run that held families out."""
    found = store.read("push-shape", 1).manifest
    measured = evaluate_shapes(network, split_shapes(table, shape_recipe.set_up), shape_recipe.seed).predictions
    assert set(found.metrics) == set(found.calibration) == set(measured) == {SEEN, UNSEEN}
    for name, each in measured.items():
        assert found.metrics[name].nll == pytest.approx(each.measures().nll, rel=1e-4)
        assert found.calibration[name].regions_90 == pytest.approx(each.regions()[1])
        assert found.calibration[name].scale


def test_the_manifest_has_the_data_and_the_domain(store: Registry, table: PushTable) -> None:
    """The digest of the table, the objects of all families, and the ranges that the version vouches for."""
    version = store.read("push-shape", 1)
    found = version.manifest
    assert (found.context_kind, found.data.split, found.data.sha256) == (ContextKind.SHAPE, ALL_FAMILIES, table.digest)
    assert found.data.train_objects == 36
    assert found.validity is not None
    assert {"length_m", "size_m"} <= set(found.validity.ranges)
    assert "## Recorded pushes\n\nscored elsewhere" in version.card


def test_a_run_of_all_families_needs_one_that_was_measured(
    shape_recipe: Recipe, network: PushNetwork, table: PushTable, tmp_path: Path
) -> None:
    """Without held-out families there is nothing to say about a version, so none is published."""
    registry = Registry(tmp_path / "models")
    with pytest.raises(DataError, match="--measured"):
        publish_shapes(replace(shape_recipe, set_up=ALL_FAMILIES), network, table, registry)
    assert not (tmp_path / "models").exists()


def test_a_network_without_finite_figures_is_not_published(
    shape_recipe: Recipe, shape_run: Path, table: PushTable, tmp_path: Path
) -> None:
    """A diverged network becomes no version."""
    broken = load_run(shape_run)[1]
    assert isinstance(broken, PushNetwork)
    with torch.no_grad():
        next(broken.parameters()).fill_(float("nan"))
    registry = Registry(tmp_path / "models")
    with pytest.raises(PublishError, match="not finite"):
        publish_shapes(shape_recipe, broken, table, registry)
    assert not (tmp_path / "models").exists()
