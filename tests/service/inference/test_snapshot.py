"""A snapshot finds the model of a reference among the served models."""

from pathlib import Path

import pytest

from service.errors import ModelNotReadyError, UnknownModelError
from service.inference.loaded_models import LoadedModels
from service.inference.readiness import Readiness
from service.inference.snapshot import DEFAULT_MODELS, Snapshot
from service.model.reference import ModelReference
from service.model.tensors import ContextKind
from tests.fakes import BROKEN, fake_models, load_fake, publish_fake

NAME = "push-indicator"


@pytest.fixture(scope="module")
def models(tmp_path_factory: pytest.TempPathFactory) -> LoadedModels:
    """Return loaded fake models."""
    return fake_models(tmp_path_factory.mktemp("models"))[1]


def test_each_kind_of_context_has_its_default_model(models: LoadedModels) -> None:
    """Without a reference, the champion of the default model for the kind of context answers."""
    assert models.snapshot.find_default(ContextKind.INDICATOR).manifest.name == NAME
    assert models.snapshot.find_default(ContextKind.NONE).manifest.name == "push-none"


def test_a_setting_names_the_default_model_of_a_kind_of_context(tmp_path: Path) -> None:
    """The champion of the named model answers, and readiness waits for that model alone."""
    registry, _ = fake_models(tmp_path)
    publish_fake(registry, "mine")
    models = LoadedModels(registry, load_fake, defaults={**DEFAULT_MODELS, ContextKind.INDICATOR: "mine"})
    models.refresh()
    assert models.snapshot.find_default(ContextKind.INDICATOR).manifest.name == "mine"
    registry.point_alias("mine", "champion", publish_fake(registry, "mine", model=BROKEN, alias=None))
    other = LoadedModels(registry, load_fake, defaults={**DEFAULT_MODELS, ContextKind.INDICATOR: "mine"})
    other.refresh()
    assert "mine@champion" in str(Readiness(other, 2.0, 1.0).reason())


@pytest.mark.parametrize("text", ["nobody", f"{NAME}@9", f"{NAME}@canary"])
def test_a_reference_that_is_not_served_is_unknown(models: LoadedModels, text: str) -> None:
    """The error of an unknown model, version or alias lists the served versions."""
    with pytest.raises(UnknownModelError, match="push-indicator@1, push-none@1"):
        models.snapshot.find(ModelReference.parse(text))


def test_a_model_has_its_versions_and_aliases(models: LoadedModels) -> None:
    """A snapshot lists names, versions and aliases, and a name that is not served has no version."""
    snapshot = models.snapshot
    assert snapshot.names() == [NAME, "push-none"]
    assert (snapshot.versions(NAME), snapshot.aliases_of(NAME)) == ([1], {"champion": 1})
    assert snapshot.aliases_of("nobody") == {}
    with pytest.raises(UnknownModelError, match="push-indicator, push-none"):
        snapshot.versions("nobody")


def test_an_empty_snapshot_is_not_ready() -> None:
    """Before any model is loaded, every reference is not ready instead of unknown, with the reason."""
    with pytest.raises(ModelNotReadyError, match="was not read yet"):
        Snapshot().find(ModelReference.parse(NAME))
    with pytest.raises(ModelNotReadyError, match="none is published"):
        Snapshot(problems=()).find_default(ContextKind.NONE)
    with pytest.raises(UnknownModelError, match="one of: none"):
        Snapshot().versions(NAME)
