"""A version of each format that was ever released, made by the code that released it, is served for ever.

``tests/data/registries/format-N`` is a whole registry. It is never regenerated; a new format adds a folder.
"""

import shutil
from pathlib import Path

import pytest

from service.errors import BrokenModelError
from service.inference.loaded_models import LoadedModels
from service.model.manifest import FORMAT, FORMATS, Manifest
from service.model.predictor import OnnxPredictor
from service.model.reference import ModelReference
from service.registry.loading import load_version
from service.registry.registry import Registry
from tests.fakes import draft_manifest

NAME = "push-none"


@pytest.fixture
def registries(project_root: Path) -> Path:
    """A registry per format."""
    return project_root / "tests" / "data" / "registries"


def test_every_format_that_is_read_has_its_sample(registries: Path) -> None:
    """And what is written now is one of them."""
    assert {path.name for path in registries.iterdir()} == {f"format-{number}" for number in FORMATS}
    assert FORMAT in FORMATS


@pytest.mark.parametrize("number", FORMATS)
def test_a_version_of_every_format_is_served(registries: Path, number: int) -> None:
    """Digests, graph, tensors, self-check, alias and history; and its bytes are what they were."""
    registry = Registry(registries / f"format-{number}")
    models = LoadedModels(registry, OnnxPredictor)
    models.refresh()
    found = models.snapshot.find(ModelReference.parse(NAME)).manifest
    assert (found.format, found.version, models.snapshot.problems) == (number, 1, ())
    assert (registry.history(NAME).problems, registry.unrecorded(NAME)) == ((), ())
    content = (registry.root / NAME / "1" / "manifest.json").read_bytes()
    assert Manifest.parse(content).render() == content


@pytest.mark.parametrize("number", FORMATS)
def test_a_registry_of_every_format_goes_on(registries: Path, number: int, tmp_path: Path) -> None:
    """The next version is of today's format, and the history becomes or stays a chain."""
    shutil.copytree(registries / f"format-{number}", tmp_path / "models")
    registry = Registry(tmp_path / "models")
    first = registry.read(NAME, 1)
    assert registry.publish(first.manifest, first.model, first.card).format == FORMAT
    assert load_version(registry, OnnxPredictor, NAME, 2).manifest.version == 2
    history = registry.history(NAME)
    assert (history.problems, [event.what for event in history.events]) == (
        (),
        ["publish", "alias champion", "publish"],
    )


def test_a_format_of_the_future_is_refused_by_name() -> None:
    """The error says which formats are read."""
    text = draft_manifest(NAME).render().replace(f'"format": {FORMAT}'.encode(), b'"format": 99')
    with pytest.raises(BrokenModelError, match="format: this version reads formats 1 and 2 only"):
        Manifest.parse(text)
