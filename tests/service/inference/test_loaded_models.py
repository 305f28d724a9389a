"""Models in memory are verified before they are reachable, and kept if their successors are broken."""

import os
import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pytest

from service.errors import ContextKindError, ModelNotReadyError, UnknownModelError
from service.inference.loaded_models import THOROUGH_EVERY, LoadedModels
from service.model.reference import ModelReference
from service.model.tensors import ContextKind, Tensor
from service.pushing.contexts import ObjectContext, VisualContext
from service.registry.registry import Registry
from tests.fakes import BROKEN, LYING, FakePredictor, fake_models, load_fake, predict_push, publish_fake

NAME = "push-indicator"
CHAMPION = ModelReference.parse(NAME)
OBJECT = ObjectContext.from_descriptor("1a2b3c4a")


@pytest.fixture
def registry(tmp_path: Path) -> Registry:
    """Return a registry of fake models."""
    return fake_models(tmp_path / "models")[0]


@pytest.fixture
def models(registry: Registry) -> LoadedModels:
    """Return its loaded models."""
    loaded = LoadedModels(registry, load_fake)
    loaded.refresh()
    return loaded


def test_a_visual_model_is_loaded_and_predicts(registry: Registry) -> None:
    """The flat context of a stored self-check reaches the predictor as an image of one channel."""
    publish_fake(registry, "push-visual", ContextKind.VISUAL)
    loaded = LoadedModels(registry, load_fake)
    loaded.refresh()
    model = loaded.snapshot.find_default(ContextKind.VISUAL)
    view = VisualContext.from_bytes(bytes([255, 255]) + bytes(1022))
    assert predict_push(model, (0.0, 0.0, 0.0), view)[0][2] == pytest.approx(2.0)
    with pytest.raises(ContextKindError, match="kind indicator"):
        predict_push(model, (0.0, 0.0, 0.0), OBJECT)


def test_no_model_is_ready_before_the_first_poll(registry: Registry) -> None:
    """A reference before the first poll is not ready, instead of unknown."""
    with pytest.raises(ModelNotReadyError):
        LoadedModels(registry, load_fake).snapshot.find(CHAMPION)


def test_a_new_version_and_a_moved_alias_are_served_after_the_next_poll(
    registry: Registry, models: LoadedModels
) -> None:
    """A new version is reachable by its number at once, and by the name of the model once the alias names it."""
    publish_fake(registry, alias=None)
    models.refresh()
    assert models.snapshot.find(CHAMPION).manifest.version == 1
    assert models.snapshot.find(ModelReference.parse(f"{NAME}@2")).manifest.version == 2
    registry.point_alias(NAME, "champion", 2)
    models.refresh()
    assert models.snapshot.find(CHAMPION).manifest.version == 2


def test_a_request_keeps_the_snapshot_that_it_started_with(registry: Registry, models: LoadedModels) -> None:
    """A swap during a request does not change its models."""
    before = models.snapshot
    publish_fake(registry)
    models.refresh()
    assert before.find(CHAMPION).manifest.version == 1
    assert models.snapshot.find(CHAMPION).manifest.version == 2


def test_a_loaded_version_is_not_loaded_again(registry: Registry, models: LoadedModels) -> None:
    """A poll that finds a new version keeps the predictors of the others."""
    before = models.snapshot.find(CHAMPION).predictor
    publish_fake(registry, alias=None)
    models.refresh()
    assert models.snapshot.find(CHAMPION).predictor is before


@pytest.mark.parametrize("model", [BROKEN, LYING], ids=["does not load", "fails its self-check"])
def test_a_broken_version_is_not_served_and_listed(registry: Registry, models: LoadedModels, model: bytes) -> None:
    """A version that fails to load is listed with its reason, and its alias keeps the previous version."""
    publish_fake(registry, model=model)
    models.refresh()
    assert models.snapshot.find(CHAMPION).manifest.version == 1
    assert any(f"{NAME}@2 is broken" in problem for problem in models.snapshot.problems)
    assert any("1 stays served" in problem for problem in models.snapshot.problems)
    with pytest.raises(UnknownModelError):
        models.snapshot.find(ModelReference.parse(f"{NAME}@2"))


def test_a_repaired_version_is_loaded_at_the_next_poll(registry: Registry, models: LoadedModels) -> None:
    """While there are problems, each poll reads all files, even if no folder changed."""
    publish_fake(registry)
    file = registry.root / NAME / "2" / "model.onnx"
    content = file.read_bytes()
    file.write_bytes(b"torn")
    models.refresh()
    assert models.snapshot.problems
    file.write_bytes(content)
    models.refresh()
    assert models.snapshot.problems == ()
    assert models.snapshot.find(CHAMPION).manifest.version == 2


def test_a_missing_registry_unloads_no_model(registry: Registry, models: LoadedModels) -> None:
    """An outage of the storage is reported, and the loaded models stay served."""
    shutil.move(registry.root, registry.root.with_name("away"))
    models.refresh()
    assert models.snapshot.find(CHAMPION).manifest.version == 1
    assert "cannot be listed" in models.snapshot.problems[0]
    shutil.move(registry.root.with_name("away"), registry.root)
    models.refresh()
    assert models.snapshot.problems == ()


@pytest.mark.parametrize("gone", ["", NAME, f"{NAME}/1", f"{NAME}/aliases", f"{NAME}/aliases/champion"])
def test_files_that_vanish_without_being_removed_stay_served(
    registry: Registry, models: LoadedModels, tmp_path: Path, gone: str
) -> None:
    """If a registry, model, version or alias vanishes, it stays served, and the problem is listed."""
    path = registry.root / gone
    shutil.move(path, tmp_path / "away")
    if not gone:
        path.mkdir()
    elif gone != NAME:
        os.utime(registry.root / NAME)
    models.refresh()
    assert models.snapshot.find(CHAMPION).manifest.version == 1
    assert any("vanished" in problem for problem in models.snapshot.problems)
    if not gone:
        path.rmdir()
    shutil.move(tmp_path / "away", path)
    models.refresh()
    assert models.snapshot.problems == ()


def test_a_removed_version_is_released(registry: Registry, models: LoadedModels) -> None:
    """A removed version and a dropped alias are released, which is not a problem."""
    publish_fake(registry, alias="canary")
    models.refresh()
    registry.drop_alias(NAME, "canary")
    registry.remove(NAME, 2)
    models.refresh()
    assert (models.snapshot.versions(NAME), models.snapshot.aliases_of(NAME)) == ([1], {"champion": 1})
    assert models.snapshot.problems == ()


def test_a_change_without_a_new_fingerprint_is_found_later(registry: Registry, models: LoadedModels) -> None:
    """An alias that is edited in place is found by the thorough poll."""
    publish_fake(registry, alias=None)
    models.refresh()
    modified = (registry.root / NAME).stat().st_mtime_ns
    (registry.root / NAME / "aliases" / "champion").write_text("2\n")
    assert (registry.root / NAME).stat().st_mtime_ns == modified
    for _ in range(THOROUGH_EVERY):
        models.refresh()
    assert models.snapshot.find(CHAMPION).manifest.version == 2


def test_an_empty_registry_may_be_filled_later(tmp_path: Path) -> None:
    """A service that starts before the first publication serves the model after the next poll."""
    (tmp_path / "models").mkdir()
    registry = Registry(tmp_path / "models")
    models = LoadedModels(registry, load_fake)
    models.refresh()
    assert models.snapshot.problems == ("the registry holds no model",)
    publish_fake(registry)
    models.refresh()
    assert models.snapshot.find(CHAMPION).manifest.version == 1


def test_old_versions_are_released_unless_an_alias_names_them(registry: Registry) -> None:
    """Memory holds the newest few versions, and those that an alias names."""
    models = LoadedModels(registry, load_fake, newest_versions=2)
    for _ in range(4):
        publish_fake(registry, alias=None)
    models.refresh()
    assert models.snapshot.versions(NAME) == [1, 4, 5]
    registry.point_alias(NAME, "champion", 5)
    models.refresh()
    assert models.snapshot.versions(NAME) == [4, 5]


def test_a_predictor_is_created_from_verified_bytes_only(registry: Registry) -> None:
    """The factory never gets bytes whose digest differs from the manifest."""
    seen: list[bytes] = []

    def load(model: bytes, inputs: Sequence[Tensor], outputs: Sequence[Tensor]) -> FakePredictor:
        seen.append(model)
        return load_fake(model, inputs, outputs)

    publish_fake(registry)
    (registry.root / NAME / "2" / "model.onnx").write_bytes(b"evil")
    LoadedModels(registry, load).refresh()
    assert seen == [b"fine", b"fine"]


def test_loaded_models_are_immutable(models: LoadedModels) -> None:
    """A loaded model is a value, and its fields cannot be set."""
    model = models.snapshot.find(CHAMPION)
    assert replace(model) == model
    with pytest.raises(AttributeError):
        model.card = "other"  # type: ignore[misc]


def test_loads_and_swaps_are_counted_once(tmp_path: Path) -> None:
    """A new alias counts as a load and not as a swap, and a second poll counts no change again."""
    registry, models = fake_models(tmp_path / "models")
    models.refresh()
    assert (models.counters.loads["push-indicator"], models.counters.swaps["push-indicator", "champion"]) == (1, 0)
    publish_fake(registry)
    models.refresh()
    models.refresh()
    assert (models.counters.loads["push-indicator"], models.counters.swaps["push-indicator", "champion"]) == (2, 1)


def test_the_state_of_the_registry_is_that_of_the_last_poll(tmp_path: Path) -> None:
    """The registry is down while it cannot be read, and up again after the next poll that reads it."""
    models = LoadedModels(Registry(tmp_path / "models"), load_fake)
    models.refresh()
    assert (models.counters.registry_up, models.counters.registry_failures) == (False, 1)
    publish_fake(Registry(tmp_path / "models"))
    models.refresh()
    assert (models.counters.registry_up, models.counters.registry_failures) == (True, 1)
