"""The README, the changelog, the Makefile and the index of results agree with the code and the models."""

import json
import re
import tomllib
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pytest
from packaging.requirements import Requirement

import service
from service.inference.snapshot import DEFAULT_MODELS
from service.model.manifest import Manifest
from service.model.predictor import OnnxPredictor
from service.model.reference import ModelReference
from service.pushing.contexts import ObjectContext
from service.registry.loading import load_version
from service.registry.registry import Registry
from tests.fakes import predict_push

SHIPPED = list(DEFAULT_MODELS.values())


@pytest.fixture(scope="module")
def readme(project_root: Path) -> str:
    """Return the text of the README."""
    return (project_root / "README.md").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def champions(project_root: Path) -> dict[str, Manifest]:
    """Return the manifests of the champions that ship, by model name."""
    registry = Registry(project_root / "models")
    names = registry.names()
    return {name: registry.read(name, registry.resolve(ModelReference.parse(name))).manifest for name in names}


def test_the_changelog_begins_with_this_version(project_root: Path) -> None:
    """The first released entry of the changelog has the version of the code."""
    found = re.search(r"^## \[(\d.*?)\]", (project_root / "CHANGELOG.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert found is not None
    assert found[1] == service.__version__


def test_the_readmes_answer_is_the_models_answer(
    readme: str, project_root: Path, champions: dict[str, Manifest]
) -> None:
    """The shipped champion predicts the numbers that the README shows below its curl command."""
    body = json.loads(re.findall(r"-d '(\{.*\})'", readme)[0])
    answer: dict[str, Any] = json.loads(re.findall(r"```json\n(.*?)```", readme, re.DOTALL)[0])
    version = champions["push-indicator"].version
    model = load_version(Registry(project_root / "models"), OnnxPredictor, "push-indicator", version)
    pusher = body["pusher"]
    context = ObjectContext.from_descriptor(body["context"]["descriptor"])
    mean, std = predict_push(model, (pusher["x"], pusher["y"], pusher["angle"]), context)
    for said, predicted in ((answer["mean"], mean), (answer["std"], std)):
        assert [said["x"], said["y"], said["angle"]] == pytest.approx(predicted, abs=1e-5)
    assert answer["model"] == {"name": "push-indicator", "version": version}


def test_every_kind_of_context_has_a_model(champions: dict[str, Manifest]) -> None:
    """A default model ships for every kind of context."""
    assert sorted(champions) == sorted(SHIPPED)


@pytest.mark.parametrize("name", SHIPPED)
def test_the_readmes_figures_are_the_manifests(readme: str, champions: dict[str, Manifest], name: str) -> None:
    """The README's row of a model has the figures of its manifest."""
    manifest = champions[name]
    part = "held-out-families" if name == "push-shape" else "different-objects"
    metrics, found = manifest.metrics[part], manifest.calibration[part]
    shares = " | ".join(f"{100 * share:.1f} %" for share in (found.coverage_50, found.coverage_90, found.coverage_95))
    figures = f"{metrics.rmse:.3f} | {metrics.distance_mm:.2f} | {metrics.nll:.2f} | {shares}"
    model = f"`{name}` {manifest.version}, {re.escape(manifest.method)}"
    assert re.search(rf"^\| {model} \|.*\| {figures} \|$", readme, re.MULTILINE)


def test_knowing_the_object_is_worth_a_factor_of_two(champions: dict[str, Manifest]) -> None:
    """On the same held-out objects the error of the models with a context is less than half of FCN's."""
    rmse = {
        name: manifest.metrics["different-objects"].rmse for name, manifest in champions.items() if name != "push-shape"
    }
    assert max(rmse["push-indicator"], rmse["push-visual"]) < rmse["push-none"] / 2.0


@pytest.mark.parametrize(
    "target", ["serve", "data", "train", "test", "lowest", "check", "openapi", "lock", "image", "size", "sbom"]
)
def test_every_documented_make_target_exists(project_root: Path, target: str) -> None:
    """A documented target is in the Makefile, with a line of help."""
    makefile = (project_root / "Makefile").read_text(encoding="utf-8")
    assert re.search(rf"^{target}:.*## ", makefile, re.MULTILINE)


def test_libraries_with_private_parts_in_use_are_held_to_a_minor_version(project_root: Path) -> None:
    """A minor version of them may change what is subclassed, so the tests and the image have the declared one.

    These are the libraries that read HTTP: ``service/connections`` subclasses uvicorn's connection, which is private.
    """
    project = tomllib.loads((project_root / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    declared = {wanted.name: wanted.specifier for wanted in map(Requirement, project["dependencies"])}
    sources = "".join(path.read_text(encoding="utf-8") for path in (project_root / "service/connections").glob("*.py"))
    private = {name for name in declared if re.search(rf"^(from|import) {name}\b", sources, re.MULTILINE)}
    assert {"uvicorn", "httptools"} <= private
    for name in private - {"starlette"}:
        (only,) = declared[name]
        assert only.operator == "==", name
        assert re.fullmatch(r"\d+\.\d+\.\*", only.version), name
        versions = {version(name)}
        for lock in ("serving", "s3", "all"):
            text = (project_root / "deploy" / "locks" / f"{lock}.txt").read_text(encoding="utf-8")
            versions |= set(re.findall(rf"^{name}==(\S+)", text, re.MULTILINE))
        assert all(found in declared[name] for found in versions), (name, versions)


def test_the_index_of_results_has_every_table_with_its_claims(project_root: Path) -> None:
    """The row of a table has the claims and the epochs of its page."""
    results = project_root / "docs" / "results"
    rows = (results / "README.md").read_text(encoding="utf-8").splitlines()
    for page in sorted(results.glob("*/README.md")):
        row = next((row for row in rows if f"({page.parent.name}/README.md)" in row), None)
        assert row is not None, page
        found = re.search(
            r"(\d+ of) the paper's (\d+) claims hold(?:, \d+ open)?\. "
            r"(?:\d+(?: to \d+)? of )?\d+ seeds? per row, (\d+) epochs",
            page.read_text("utf-8"),
        )
        if found is not None:  # a table of the paper
            _, _, epochs, claims, _, _ = row.split("|")
            assert (claims.strip(), epochs.split(",")[0].strip()) == (f"{found[1]} {found[2]}", found[3])
