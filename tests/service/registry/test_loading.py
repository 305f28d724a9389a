"""A version is loaded once it is verified and its self-check has passed."""

from pathlib import Path

import pytest

from service.errors import BrokenModelError
from service.registry.loading import load_version
from service.registry.registry import Registry
from tests.fakes import BROKEN, LYING, load_fake, publish_fake

NAME = "push-indicator"


@pytest.fixture
def registry(tmp_path: Path) -> Registry:
    """Return an empty registry."""
    return Registry(tmp_path)


def test_a_verified_version_is_loaded(registry: Registry) -> None:
    """A loaded model has the manifest, the card and a predictor of the verified bytes."""
    publish_fake(registry)
    model = load_version(registry, load_fake, NAME, 1)
    assert (model.manifest.name, model.manifest.version, model.card) == (NAME, 1, f"# {NAME}\n")


@pytest.mark.parametrize("model", [BROKEN, LYING], ids=["does not load", "fails its self-check"])
def test_a_version_that_fails_is_not_loaded(registry: Registry, model: bytes) -> None:
    """A graph that does not load and a self-check that fails are errors of the version."""
    publish_fake(registry, model=model)
    with pytest.raises(BrokenModelError):
        load_version(registry, load_fake, NAME, 1)


def test_a_version_with_other_bytes_is_not_loaded(registry: Registry) -> None:
    """The predictor is not created from bytes whose digest differs from the manifest."""
    publish_fake(registry)
    (registry.root / NAME / "1" / "model.onnx").write_bytes(b"evil")
    with pytest.raises(BrokenModelError, match=r"model\.onnx"):
        load_version(registry, load_fake, NAME, 1)
