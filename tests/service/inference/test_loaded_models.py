"""Models in memory: verified before they are reachable, swapped whole, kept when what follows is broken."""

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
from tests.fakes import BROKEN, LYING, STD, FakePredictor, fake_models, load_fake, predict_push, publish_fake

NAME = "push-indicator"
CHAMPION = ModelReference.parse(NAME)
OBJECT = ObjectContext.from_descriptor("1a2b3c4a")


@pytest.fixture
def registry(tmp_path: Path) -> Registry:
    """A registry of fakes."""
    return fake_models(tmp_path / "models")[0]


@pytest.fixture
def models(registry: Registry) -> LoadedModels:
    """What serves it."""
    loaded = LoadedModels(registry, load_fake)
    loaded.refresh()
    return loaded


def test_a_push_is_predicted_in_domain_values(models: LoadedModels) -> None:
    """Poses in, a Gaussian out; the context reaches the predictor, the angle comes out wrapped."""
    (x_m, _, angle_rad), std = predict_push(models.snapshot.find(CHAMPION), (-0.08, 0.02, 0.0), OBJECT)
    turned = 8.0 - 6.283185307179586  # eight ones in an indicator
    assert x_m == pytest.approx(0.008)
    assert angle_rad == pytest.approx(turned, abs=1e-6)
    assert std == pytest.approx(list(STD))


def test_the_context_must_be_of_the_models_kind(models: LoadedModels) -> None:
    """A context for a model without, and none for a model with, are the caller's mistakes."""
    with pytest.raises(ContextKindError, match="kind none"):
        predict_push(models.snapshot.find(CHAMPION), (0.0, 0.0, 0.0), None)
    with pytest.raises(ContextKindError, match="kind indicator"):
        predict_push(models.snapshot.find_default(ContextKind.NONE), (0.0, 0.0, 0.0), OBJECT)


def test_a_visual_model_passes_its_self_check_and_takes_views(registry: Registry) -> None:
    """The stored context is a flat row; what reaches the predictor is an image of one channel."""
    publish_fake(registry, "push-visual", ContextKind.VISUAL)
    loaded = LoadedModels(registry, load_fake)
    loaded.refresh()
    model = loaded.snapshot.find_default(ContextKind.VISUAL)
    view = VisualContext.from_bytes(bytes([255, 255]) + bytes(1022))
    assert predict_push(model, (0.0, 0.0, 0.0), view)[0][2] == pytest.approx(2.0)
    with pytest.raises(ContextKindError, match="kind indicator"):
        predict_push(model, (0.0, 0.0, 0.0), OBJECT)


def test_before_the_first_look_nothing_is_ready(registry: Registry) -> None:
    """Asking too early is told so, not 'unknown'."""
    with pytest.raises(ModelNotReadyError):
        LoadedModels(registry, load_fake).snapshot.find(CHAMPION)


def test_each_kind_of_context_has_its_default_model(models: LoadedModels) -> None:
    """Who names no model gets the champion for what is known of the object."""
    assert models.snapshot.find_default(ContextKind.INDICATOR).manifest.name == NAME
    assert models.snapshot.find_default(ContextKind.NONE).manifest.name == "push-none"


@pytest.mark.parametrize("text", ["nobody", f"{NAME}@9", f"{NAME}@canary"])
def test_what_is_not_served_is_unknown_and_the_error_lists_what_is(models: LoadedModels, text: str) -> None:
    """Model, version or alias."""
    with pytest.raises(UnknownModelError, match="push-indicator@1, push-none@1"):
        models.snapshot.find(ModelReference.parse(text))


def test_a_new_version_and_a_moved_alias_are_served_after_the_next_look(
    registry: Registry, models: LoadedModels
) -> None:
    """The version is reachable at once by number; the name follows its alias."""
    publish_fake(registry, alias=None)
    models.refresh()
    assert models.snapshot.find(CHAMPION).manifest.version == 1
    assert models.snapshot.find(ModelReference.parse(f"{NAME}@2")).manifest.version == 2
    registry.point_alias(NAME, "champion", 2)
    models.refresh()
    assert models.snapshot.find(CHAMPION).manifest.version == 2


def test_a_request_keeps_the_snapshot_that_it_started_with(registry: Registry, models: LoadedModels) -> None:
    """A swap in the middle of a request changes nothing for it."""
    before = models.snapshot
    publish_fake(registry)
    models.refresh()
    assert before.find(CHAMPION).manifest.version == 1
    assert models.snapshot.find(CHAMPION).manifest.version == 2


def test_what_is_loaded_is_not_loaded_again(registry: Registry, models: LoadedModels) -> None:
    """A look that finds something new keeps the predictors it has."""
    before = models.snapshot.find(CHAMPION).predictor
    publish_fake(registry, alias=None)
    models.refresh()
    assert models.snapshot.find(CHAMPION).predictor is before


@pytest.mark.parametrize("model", [BROKEN, LYING], ids=["does not load", "fails its self-check"])
def test_a_broken_version_is_not_served_and_says_why(registry: Registry, models: LoadedModels, model: bytes) -> None:
    """It passes its digests and is refused all the same; what was served before goes on."""
    publish_fake(registry, model=model)
    models.refresh()
    assert models.snapshot.find(CHAMPION).manifest.version == 1
    assert any(f"{NAME}@2 is broken" in problem for problem in models.snapshot.problems)
    assert any("1 stays served" in problem for problem in models.snapshot.problems)
    with pytest.raises(UnknownModelError):
        models.snapshot.find(ModelReference.parse(f"{NAME}@2"))


def test_a_mended_registry_is_noticed_without_a_change_of_folders(registry: Registry, models: LoadedModels) -> None:
    """As long as something is wrong, every look looks again."""
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


def test_a_registry_that_is_gone_unloads_nothing(registry: Registry, models: LoadedModels) -> None:
    """A storage blip is a problem to report, not a reason to stop serving."""
    shutil.move(registry.root, registry.root.with_name("away"))
    models.refresh()
    assert models.snapshot.find(CHAMPION).manifest.version == 1
    assert "cannot be listed" in models.snapshot.problems[0]
    shutil.move(registry.root.with_name("away"), registry.root)
    models.refresh()
    assert models.snapshot.problems == ()


@pytest.mark.parametrize("gone", ["", NAME, f"{NAME}/1", f"{NAME}/aliases", f"{NAME}/aliases/champion"])
def test_what_vanishes_without_being_removed_goes_on_being_served(
    registry: Registry, models: LoadedModels, tmp_path: Path, gone: str
) -> None:
    """A mount that leaves an empty folder behind, a model, a version, an alias: a problem, and no one is unloaded."""
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


def test_what_was_removed_is_let_go(registry: Registry, models: LoadedModels) -> None:
    """A removed version and a dropped alias leave the memory without a word."""
    publish_fake(registry, alias="canary")
    models.refresh()
    registry.drop_alias(NAME, "canary")
    registry.remove(NAME, 2)
    models.refresh()
    assert (models.snapshot.versions(NAME), models.snapshot.aliases_of(NAME)) == ([1], {"champion": 1})
    assert models.snapshot.problems == ()


def test_a_change_that_no_folder_tells_of_is_found_in_time(registry: Registry, models: LoadedModels) -> None:
    """An alias edited in place by hand is noticed by the thorough look."""
    publish_fake(registry, alias=None)
    models.refresh()
    modified = (registry.root / NAME).stat().st_mtime_ns
    (registry.root / NAME / "aliases" / "champion").write_text("2\n")
    assert (registry.root / NAME).stat().st_mtime_ns == modified
    for _ in range(THOROUGH_EVERY):
        models.refresh()
    assert models.snapshot.find(CHAMPION).manifest.version == 2


def test_an_empty_registry_is_not_ready_and_is_filled_later(tmp_path: Path) -> None:
    """Starting before the first model is published is no failure."""
    (tmp_path / "models").mkdir()
    registry = Registry(tmp_path / "models")
    models = LoadedModels(registry, load_fake)
    models.refresh()
    assert models.snapshot.problems == ("the registry holds no model",)
    publish_fake(registry)
    models.refresh()
    assert models.snapshot.find(CHAMPION).manifest.version == 1


def test_old_versions_are_released_unless_an_alias_names_them(registry: Registry) -> None:
    """Memory holds the newest few and what aliases mean."""
    models = LoadedModels(registry, load_fake, newest_versions=2)
    for _ in range(4):
        publish_fake(registry, alias=None)
    models.refresh()
    assert models.snapshot.versions(NAME) == [1, 4, 5]
    registry.point_alias(NAME, "champion", 5)
    models.refresh()
    assert models.snapshot.versions(NAME) == [4, 5]


def test_a_predictor_is_only_made_from_verified_bytes(registry: Registry) -> None:
    """The factory never sees a byte whose digest was not compared."""
    seen: list[bytes] = []

    def load(model: bytes, inputs: Sequence[Tensor], outputs: Sequence[Tensor]) -> FakePredictor:
        seen.append(model)
        return load_fake(model, inputs, outputs)

    publish_fake(registry)
    (registry.root / NAME / "2" / "model.onnx").write_bytes(b"evil")
    LoadedModels(registry, load).refresh()
    assert seen == [b"fine", b"fine"]


def test_models_are_values(models: LoadedModels) -> None:
    """What is served cannot be changed in place."""
    model = models.snapshot.find(CHAMPION)
    assert replace(model) == model
    with pytest.raises(AttributeError):
        model.card = "other"  # type: ignore[misc]


def test_an_alias_that_is_new_is_a_load_and_no_swap(tmp_path: Path) -> None:
    """A swap is a change of what was served; looking twice counts nothing twice."""
    registry, models = fake_models(tmp_path / "models")
    models.refresh()
    assert (models.counters.loads["push-indicator"], models.counters.swaps["push-indicator", "champion"]) == (1, 0)
    publish_fake(registry)
    models.refresh()
    models.refresh()
    assert (models.counters.loads["push-indicator"], models.counters.swaps["push-indicator", "champion"]) == (2, 1)


def test_a_registry_is_down_until_it_is_seen(tmp_path: Path) -> None:
    """And up again as soon as it is."""
    models = LoadedModels(Registry(tmp_path / "models"), load_fake)
    models.refresh()
    assert (models.counters.registry_up, models.counters.registry_failures) == (False, 1)
    publish_fake(Registry(tmp_path / "models"))
    models.refresh()
    assert (models.counters.registry_up, models.counters.registry_failures) == (True, 1)
