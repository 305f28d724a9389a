"""``cazsl-train fit``, ``evaluate`` and ``publish``: figures and the next step, or one line and status 1."""

import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from service.model.tensors import ContextKind
from service.pushing.images import IMAGE_CONVENTION
from service.registry.registry import Registry
from tests.training.command_line import cazsl_train, sole_line
from tests.training.synthetic_omnipush import write_linked_views
from training.fitting.evaluation import evaluate
from training.fitting.recipe import Recipe
from training.fitting.run_folder import WEIGHTS_FILE, load_run
from training.fitting.samples import Samples
from training.omnipush.declaration import DATASET_FILE
from training.omnipush.published import different_objects, omnipush_descriptors
from training.omnipush.pushes import OUTCOME_SUFFIX, PUSHER_SUFFIX, read_folder


@pytest.fixture(scope="module")
def views(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with declared views of all objects. Tests must not change it."""
    return write_linked_views(tmp_path_factory.mktemp("drawn") / "views")


def test_fit_without_data_names_the_folder(tmp_path: Path) -> None:
    """The error about missing data names the folder and the way to get data, and no run is begun."""
    run = tmp_path / "run"
    line = sole_line(cazsl_train("fit", "push-indicator", "--data", tmp_path / "nowhere", "--run", run))

    assert str(tmp_path / "nowhere") in line
    assert "make data" in line
    assert not run.exists()


def test_fit_of_an_unknown_recipe_lists_those_that_exist(data_folder: Path, tmp_path: Path) -> None:
    """The error about an unknown recipe lists the recipes that ship."""
    line = sole_line(cazsl_train("fit", "push-smell", "--data", data_folder, "--run", tmp_path / "run"))

    assert "paper, push-anp, push-indicator, push-none, push-shape, push-visual" in line


def test_fit_trains_a_recipe_file(recipe: Recipe, data_folder: Path, tmp_path: Path) -> None:
    """A recipe given by path leaves a finished run, and the next step is printed."""
    path, run = tmp_path / "mine.toml", tmp_path / "run"
    fields = replace(recipe, epochs=1).record()
    path.write_text("".join(f"{key} = {value!r}\n" for key, value in fields.items()), encoding="utf-8")

    result = cazsl_train("fit", path, "--data", data_folder, "--run", run)

    assert result.exit_code == 0
    assert result.stdout == f"weights and metrics are in {run}; next: cazsl-train evaluate {run} --data {data_folder}\n"
    assert load_run(run)[0] == replace(recipe, epochs=1)


def test_evaluate_prints_the_figures_of_the_held_out_objects(data_folder: Path, indicator_run: Path) -> None:
    """Method, data and figures are printed under their names, with the next step."""
    held_out = Samples.of(read_folder(data_folder).select(different_objects().test), ContextKind.INDICATOR)
    figures = evaluate(load_run(indicator_run)[1], held_out)

    result = cazsl_train("evaluate", indicator_run, "--data", data_folder)

    title, names, numbers, factor, heading, *bands, following = result.stdout.splitlines()
    assert result.exit_code == 0
    assert title == "FCN + CM + L2Reg, 3 epochs, different-objects: 50 held-out objects of synthetic pushes of a test"
    assert " ".join(names.split()) == "RMSE STD Dist. (mm) NLL 50 % cov. 90 % cov. 95 % cov."
    assert numbers.split()[:4] == [
        f"{figures.rmse:.4f}",
        f"{figures.std:.4f}",
        f"{figures.distance_mm:.2f}",
        f"{figures.nll:.3f}",
    ]
    assert numbers.split()[4::2] == [f"{100 * share:.1f}" for share in figures.coverage.values()]
    assert len(names) == len(numbers)
    assert "a factor from held-out objects" in factor
    assert heading.split()[:2] == ["pushes", "RMSE"]
    assert [line.split()[:2] for line in bands[:2]] == [["all", "pushes"], ["start", "75"]]
    assert all(len(line) == len(heading) for line in bands)
    assert following == f"next: cazsl-train publish {indicator_run} --data {data_folder}"


@pytest.mark.parametrize("command", ["evaluate", "publish"])
def test_an_unfinished_run_is_named(data_folder: Path, indicator_run: Path, tmp_path: Path, command: str) -> None:
    """The error about an unfinished run names it and the command that finishes it."""
    run = tmp_path / "run"
    shutil.copytree(indicator_run, run)
    (run / WEIGHTS_FILE).unlink()

    line = sole_line(cazsl_train(command, run, "--data", data_folder))
    assert str(run) in line
    assert "cazsl-train fit" in line


def test_publish_makes_a_version_and_its_champion(data_folder: Path, none_run: Path, tmp_path: Path) -> None:
    """The first version becomes the champion, and a later one is promoted by the command in the last line."""
    registry = Registry(tmp_path / "models")
    first = cazsl_train("publish", none_run, "--data", data_folder, "--registry", registry.root)
    second = cazsl_train("publish", none_run, "--data", data_folder, "--registry", registry.root)

    assert (first.exit_code, second.exit_code) == (0, 0)
    assert first.stdout.splitlines() == [
        f"published push-none@1 in {registry.root}",
        "push-none@champion is version 1 now",
        "next: cazsl models show push-none@1",
    ]
    assert second.stdout.splitlines() == [
        f"published push-none@2 in {registry.root}",
        "next: cazsl models promote push-none 2 --alias champion",
    ]
    assert registry.versions("push-none") == [1, 2]
    assert registry.aliases("push-none") == {"champion": 1}


def test_publish_without_an_alias_leaves_even_a_first_version_unnamed(
    data_folder: Path, none_run: Path, tmp_path: Path
) -> None:
    """A first version published with --no-alias gets no alias."""
    registry = Registry(tmp_path / "models")
    result = cazsl_train("publish", none_run, "--data", data_folder, "--registry", registry.root, "--no-alias")

    assert result.exit_code == 0
    assert registry.versions("push-none") == [1]
    assert registry.aliases("push-none") == {}


def test_a_meta_learner_is_evaluated_and_published_by_the_size_of_its_supports(
    data_folder: Path, support_run: Path, none_run: Path, tmp_path: Path
) -> None:
    """Figures are printed for every number of support pushes, and the version is one of its model."""
    options = ("--data", data_folder)
    lines = cazsl_train("evaluate", support_run, *options).stdout.splitlines()
    heading = next(place for place, line in enumerate(lines) if line.startswith("pushes in the support"))
    assert [line.split()[0] for line in lines[heading + 1 : heading + 7]] == ["1", "2", "5", "10", "20", "50"]
    assert {len(line) for line in lines[heading : heading + 7]} == {len(lines[heading])}
    registry = Registry(tmp_path / "models")
    refused = cazsl_train("publish", support_run, *options, "--registry", registry.root, "--measured", none_run)
    assert "fit push-anp" in sole_line(refused)
    result = cazsl_train("publish", support_run, *options, "--registry", registry.root)
    assert result.exit_code == 0, result.output
    assert registry.read("push-anp", 1).manifest.context_kind is ContextKind.SUPPORT


def test_a_model_of_all_objects_is_published_with_the_figures_of_a_run_that_held_some_out(
    recipe: Recipe, data_folder: Path, indicator_run: Path, tmp_path: Path
) -> None:
    """A run on all objects is published with the figures of a measured run of its recipe, and refused without."""
    path, registry = tmp_path / "push-indicator.toml", Registry(tmp_path / "models")
    path.write_text("".join(f"{key} = {value!r}\n" for key, value in recipe.record().items()), encoding="utf-8")
    run, options = tmp_path / "run", ("--data", data_folder)
    publishing = ("publish", run, *options, "--registry", registry.root)

    fitted = cazsl_train("fit", path, *options, "--run", run, "--set-up", "all-objects")
    assert f"publish {run} --measured RUN" in fitted.stdout
    assert "different-objects" in sole_line(cazsl_train("evaluate", run, *options))
    assert "--set-up different-objects" in sole_line(cazsl_train(*publishing))
    assert not registry.root.exists()
    result = cazsl_train(*publishing, "--measured", indicator_run)

    assert result.exit_code == 0, result.output
    assert registry.read("push-indicator", 1).manifest.recipe["set_up"] == "all-objects"


def test_publish_with_other_data_is_refused(data_folder: Path, none_run: Path, tmp_path: Path) -> None:
    """A run is not published with data that it was not trained on, as their figures would be in its card."""
    other, first = tmp_path / "other", omnipush_descriptors()[0]
    shutil.copytree(data_folder, other)
    for suffix in (PUSHER_SUFFIX, OUTCOME_SUFFIX):
        shutil.copy(other / (omnipush_descriptors()[1] + suffix), other / (first + suffix))
    assert (other / DATASET_FILE).read_bytes() == (data_folder / DATASET_FILE).read_bytes()

    line = sole_line(cazsl_train("publish", none_run, "--data", other, "--registry", tmp_path / "models"))
    assert str(other) in line
    assert str(none_run) in line
    assert "--data" in line
    assert not (tmp_path / "models").exists()


def test_a_visual_model_is_fitted_evaluated_and_published_with_its_views(
    recipe: Recipe, data_folder: Path, views: Path, tmp_path: Path
) -> None:
    """The option --views is repeated in the next step, and the manifest has the views' convention."""
    path, run = tmp_path / "push-visual.toml", tmp_path / "run"
    fields = replace(recipe, name="push-visual", context="visual", epochs=1).record()
    path.write_text("".join(f"{key} = {value!r}\n" for key, value in fields.items()), encoding="utf-8")
    options = ("--data", data_folder, "--views", views)

    fitted = cazsl_train("fit", path, "--run", run, *options)
    evaluated = cazsl_train("evaluate", run, *options)
    published = cazsl_train("publish", run, *options, "--registry", tmp_path / "models")

    assert fitted.stdout.endswith(f"next: cazsl-train evaluate {run} --data {data_folder} --views {views}\n")
    assert evaluated.exit_code == 0
    assert published.exit_code == 0, published.output
    manifest = Registry(tmp_path / "models").read("push-visual", 1).manifest
    assert (manifest.context_kind, manifest.image_convention) == (ContextKind.VISUAL, IMAGE_CONVENTION)


def test_publish_with_other_views_is_refused(data_folder: Path, visual_run: Path, views: Path, tmp_path: Path) -> None:
    """Views are part of the data that a visual model was trained on."""
    options = ("--data", data_folder, "--views", views, "--registry", tmp_path / "models")

    assert "other views with --views" in sole_line(cazsl_train("publish", visual_run, *options))
    assert not (tmp_path / "models").exists()
