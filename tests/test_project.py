"""What the project says of itself is so."""

import json
import re
from pathlib import Path
from typing import Any

import pytest

import service
from service.contract import ObjectContext, Pose
from service.loaded_models import load_version
from service.manifest import Manifest
from service.predictor import OnnxPredictor
from service.registry import Registry


@pytest.fixture(scope="module")
def readme(project_root: Path) -> str:
    """The README."""
    return (project_root / "README.md").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def first_version(project_root: Path) -> Manifest:
    """The manifest of the model that the README speaks of."""
    return Registry(project_root / "models").read("push-indicator", 1).manifest


def test_the_changelog_begins_with_this_version(project_root: Path) -> None:
    """The top entry that is released is the version of the code."""
    found = re.search(r"^## \[(\d.*?)\]", (project_root / "CHANGELOG.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert found is not None
    assert found[1] == service.__version__


def test_the_readmes_answer_is_the_models_answer(readme: str, project_root: Path) -> None:
    """The curl line's push, given to the model that ships, gives the numbers that stand below it."""
    body = json.loads(re.findall(r"-d '(\{.*\})'", readme)[0])
    answer: dict[str, Any] = json.loads(re.findall(r"```json\n(.*?)```", readme, re.DOTALL)[0])
    model = load_version(Registry(project_root / "models"), OnnxPredictor, "push-indicator", 1)
    pusher = body["pusher"]
    gaussian = model.predict_push(
        Pose.wrapped(pusher["x"], pusher["y"], pusher["angle"]),
        ObjectContext.from_descriptor(body["context"]["descriptor"]),
    )
    for said, pose in ((answer["mean"], gaussian.mean), (answer["std"], gaussian.std)):
        assert [said["x"], said["y"], said["angle"]] == pytest.approx([pose.x_m, pose.y_m, pose.angle_rad], abs=1e-5)
    assert answer["model"] == {"name": "push-indicator", "version": 1}


def test_the_readmes_figures_are_the_manifests(readme: str, first_version: Manifest) -> None:
    """The row of the shipped model is what was measured when it was published."""
    metrics = first_version.metrics["different-objects"]
    coverage = first_version.calibration["different-objects"].coverage_90
    figures = (f"{metrics.rmse:.3f}", f"{metrics.std:.3f}", f"{metrics.distance_mm:.2f}", f"{metrics.nll:.2f}")
    assert f"| {' | '.join(figures)} | {100 * coverage:.1f} % |" in readme


def test_the_shipped_model_is_clearly_better_than_one_that_knows_nothing_of_the_object(
    readme: str, first_version: Manifest
) -> None:
    """FCN's row of the README, measured on the same objects after as many epochs, has at least twice the error."""
    fcn = re.search(r"^\| FCN, .*?\| ([\d.]+) \|", readme, re.MULTILINE)
    assert fcn is not None
    assert first_version.metrics["different-objects"].rmse < float(fcn[1]) / 2.0


@pytest.mark.parametrize("target", ["serve", "data", "train", "test", "check", "openapi", "lock", "image", "sbom"])
def test_the_commands_that_the_project_speaks_of_exist(project_root: Path, target: str) -> None:
    """Each make target is there and says what it does."""
    makefile = (project_root / "Makefile").read_text(encoding="utf-8")
    assert re.search(rf"^{target}:.*## ", makefile, re.MULTILINE)
