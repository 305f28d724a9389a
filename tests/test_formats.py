"""Manifest formats: a version of each released format, written by the code of its release, is served for ever.

``tests/data/registries/format-N`` is a whole registry. It is never generated again. A new format adds a folder.
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
    """Return the folder with one registry per format."""
    return project_root / "tests" / "data" / "registries"


def test_every_readable_format_has_a_sample(registries: Path) -> None:
    """Every readable format has a sample registry, and the format that is written is among them."""
    assert {path.name for path in registries.iterdir()} == {f"format-{number}" for number in FORMATS}
    assert FORMAT in FORMATS


@pytest.mark.parametrize("number", FORMATS)
def test_a_version_of_every_format_is_served(registries: Path, number: int) -> None:
    """A version of every format passes all verification, has its alias and history, and renders to the same bytes."""
    registry = Registry(registries / f"format-{number}")
    models = LoadedModels(registry, OnnxPredictor)
    models.refresh()
    found = models.snapshot.find(ModelReference.parse(NAME)).manifest
    assert (found.format, found.version, models.snapshot.problems) == (number, 1, ())
    assert (registry.history(NAME).problems, registry.unrecorded(NAME)) == ((), ())
    content = (registry.root / NAME / "1" / "manifest.json").read_bytes()
    assert Manifest.parse(content).render() == content


@pytest.mark.parametrize("number", FORMATS)
def test_a_registry_of_every_format_takes_new_versions(registries: Path, number: int, tmp_path: Path) -> None:
    """The next version in a registry of any format has the current format, and the history is a chain."""
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


def test_an_unknown_format_is_refused() -> None:
    """A manifest of an unknown format is refused with the list of readable formats."""
    text = draft_manifest(NAME).render().replace(f'"format": {FORMAT}'.encode(), b'"format": 99')
    with pytest.raises(BrokenModelError, match="format: this version reads formats 1, 2, 3 only"):
        Manifest.parse(text)
