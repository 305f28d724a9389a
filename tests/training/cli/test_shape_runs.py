"""``cazsl-train fit``, ``evaluate`` and ``publish`` on a table of shapes: the same steps as for Omnipush."""

from dataclasses import replace
from pathlib import Path

import pytest

from service.registry.registry import Registry
from tests.training.command_line import cazsl_train, sole_line
from training.fitting.recipe import ALL_FAMILIES, Recipe
from training.fitting.run_folder import load_run


@pytest.fixture(scope="module")
def recipe_file(tmp_path_factory: pytest.TempPathFactory, shape_recipe: Recipe) -> Path:
    """File of a recipe of one epoch."""
    path = tmp_path_factory.mktemp("recipe") / "short.toml"
    fields = replace(shape_recipe, epochs=1).record()
    path.write_text("".join(f"{key} = {value!r}\n" for key, value in fields.items()), encoding="utf-8")
    return path


def test_fit_trains_a_network_of_shapes(recipe_file: Path, shapes_folder: Path, tmp_path: Path) -> None:
    """A recipe of shapes leaves a finished run, and the next step is printed."""
    run = tmp_path / "run"
    result = cazsl_train("fit", recipe_file, "--data", shapes_folder, "--run", run)
    assert result.exit_code == 0
    following = f"next: cazsl-train evaluate {run} --data {shapes_folder}\n"
    assert result.stdout == f"weights and metrics are in {run}; {following}"
    assert load_run(run)[0].epochs == 1


def test_evaluate_prints_both_held_out_parts(shape_run: Path, shapes_folder: Path) -> None:
    """Objects and families have a line of figures, and the factor is named."""
    result = cazsl_train("evaluate", shape_run, "--data", shapes_folder)
    title, heading, objects, families, factor, following = result.stdout.splitlines()
    assert result.exit_code == 0
    assert title.startswith("FCN + CM, 2 epochs, different-families: held-out objects of simulated pushes")
    assert heading.split()[:3] == ["pushes", "RMSE", "NLL"]
    assert [line.split()[0] for line in (objects, families)] == ["held-out-objects", "held-out-families"]
    assert len(objects) == len(families)
    assert "conformal factor" in factor
    assert following.startswith(f"next: cazsl-train fit push-shape --set-up {ALL_FAMILIES} --data {shapes_folder}")


def test_publish_puts_a_version_with_the_scores_into_the_registry(
    shape_run: Path, shapes_folder: Path, tmp_path: Path
) -> None:
    """The text of a file comes onto the card, and the version is in the registry."""
    scores = tmp_path / "scores.md"
    scores.write_text("## Recorded pushes\n\nsome\n", encoding="utf-8")
    folder = tmp_path / "models"
    result = cazsl_train("publish", shape_run, "--data", shapes_folder, "--registry", folder, "--scores", scores)
    assert result.exit_code == 0, result.output
    assert "## Recorded pushes\n\nsome\n" in Registry(folder).read("push-shape", 1).card


def test_publish_refuses_scores_that_cannot_be_read(shape_run: Path, shapes_folder: Path, tmp_path: Path) -> None:
    """A file that is not there is one line, and no version."""
    gone, folder = tmp_path / "gone.md", tmp_path / "models"
    line = sole_line(cazsl_train("publish", shape_run, "--data", shapes_folder, "--registry", folder, "--scores", gone))
    assert str(gone) in line
    assert not folder.exists()


def test_publish_refuses_another_table_than_that_of_the_run(
    shape_run: Path, shapes_folder: Path, tmp_path: Path
) -> None:
    """Figures of a version are those of the data that it was trained on."""
    other = tmp_path / "other"
    made = cazsl_train("simulate", "shapes", other, "--objects", "6", "--pushes", "4")
    assert made.exit_code == 0, made.output
    line = sole_line(cazsl_train("publish", shape_run, "--data", other, "--registry", tmp_path / "models"))
    assert str(other) in line
    assert "--data" in line
