"""``cazsl-train`` as a person uses it: figures and the next step on success, one line and status 1 otherwise."""

import json
import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result

import service
from service.model.tensors import ContextKind
from service.pushing.images import IMAGE_CONVENTION
from service.registry.registry import Registry
from training.cli.main import main
from training.fitting.evaluation import evaluate
from training.fitting.recipe import Recipe
from training.fitting.run_folder import WEIGHTS_FILE, load_run
from training.fitting.samples import Samples
from training.networks.methods import FCN, METHODS
from training.omnipush.declaration import DATASET_FILE, declare_dataset
from training.omnipush.published import different_objects, different_surfaces, omnipush_descriptors
from training.omnipush.pushes import OUTCOME_SUFFIX, PUSHER_SUFFIX, read_folder, write_object
from training.simulation.dataset import SimulationPlan
from training.simulation.drawing import write_views


def cazsl_train(*arguments: str | Path) -> Result:
    """Run the command line in this process."""
    return CliRunner().invoke(main, [str(argument) for argument in arguments])


def sole_line(result: Result) -> str:
    """The one line of an error that was meant for a person."""
    assert result.exit_code == 1
    assert result.stdout == ""
    (line,) = result.stderr.splitlines()
    assert line.startswith("Error: ")
    return line


def test_help_lists_the_commands() -> None:
    """Each with what it does, and the four steps in order."""
    result = cazsl_train("--help")

    assert result.exit_code == 0
    for command in ("simulate", "images", "fit", "evaluate", "publish"):
        assert f"\n  {command} " in result.output, command
    assert result.output.index("cazsl-train simulate") < result.output.index("cazsl-train publish")


@pytest.mark.parametrize("command", ["simulate", "fit", "evaluate", "publish", "reproduce"])
def test_every_command_explains_itself(command: str) -> None:
    """-h gives its usage and says where the data is."""
    result = cazsl_train(command, "-h")

    assert result.exit_code == 0
    assert result.output.startswith("Usage: ")
    assert "data/simulated" in result.output


def test_the_version_is_the_package_s() -> None:
    """One number for trainer and service."""
    assert cazsl_train("--version").output == f"cazsl-train, version {service.__version__}\n"


def test_simulate_goes_on_where_it_stopped_and_describes_the_dataset(data_folder: Path, tmp_path: Path) -> None:
    """Two objects of 250 are left to simulate; the whole folder is then told of, beside the published statistics."""
    folder, left = tmp_path / "abs", omnipush_descriptors()[3:5]
    declare_dataset(folder, SimulationPlan(omnipush_descriptors(), pushes_per_object=2, seed=4).declaration())
    for path in data_folder.glob("*.npy"):
        if not path.name.startswith(left):
            shutil.copy(path, folder / path.name)

    result = cazsl_train("simulate", tmp_path, *["--surface", "abs", "--pushes", "2", "--seed", "4", "--threads", "1"])

    found = read_folder(folder)
    assert result.exit_code == 0
    assert f"{found.source}: 250 objects, {found.count} pushes" in result.stdout
    assert found.digest in result.stdout
    assert "object yaw_rad" in result.stdout
    assert re.search(r"^4 pushes took \d+ s, [\d.]+ ms a push$", result.stdout, re.MULTILINE)
    assert result.stdout.endswith("next: cazsl-train fit push-indicator\n")
    assert found.valid[[found.descriptors.index(descriptor) for descriptor in left]].sum(axis=1).tolist() == [2, 2]


def test_simulate_pushes_the_published_ten_on_plywood(tmp_path: Path) -> None:
    """Surfaces have folders of their own, and the source says which it was."""
    result = cazsl_train("simulate", tmp_path, *["--surface", "plywood", "--pushes", "1", "--threads", "1"])

    found = read_folder(tmp_path / "plywood")
    assert result.exit_code == 0
    assert found.descriptors == different_surfaces().test
    assert "PLYWOOD" in found.source
    assert sorted(path.name for path in tmp_path.iterdir()) == ["plywood", "top-down_view"]
    assert len(list((tmp_path / "top-down_view").glob("shape_*.npy"))) == 10


def test_simulate_refuses_a_folder_of_other_pushes(data_folder: Path, tmp_path: Path) -> None:
    """One line names the folder; what is there is not touched."""
    folder = shutil.copytree(data_folder, tmp_path / "abs")

    assert str(folder) in sole_line(cazsl_train("simulate", tmp_path, "--pushes", "1"))
    assert read_folder(folder).digest == read_folder(data_folder).digest


@pytest.mark.parametrize("count", ["0", "-1", "many"])
def test_simulate_refuses_an_impossible_number_of_pushes(tmp_path: Path, count: str) -> None:
    """It is a wrong use of the command, status 2, and nothing is made."""
    result = cazsl_train("simulate", tmp_path, "--pushes", count)

    assert result.exit_code == 2
    assert "--pushes" in result.stderr
    assert not (tmp_path / "abs").exists()


def test_fit_without_data_names_the_folder(tmp_path: Path) -> None:
    """One line says what is missing and how to get it; no run is begun."""
    run = tmp_path / "run"
    line = sole_line(cazsl_train("fit", "push-indicator", "--data", tmp_path / "nowhere", "--run", run))

    assert str(tmp_path / "nowhere") in line
    assert "make data" in line
    assert not run.exists()


def test_fit_of_an_unknown_recipe_lists_those_that_exist(data_folder: Path, tmp_path: Path) -> None:
    """One line has the names that would have worked."""
    line = sole_line(cazsl_train("fit", "push-smell", "--data", data_folder, "--run", tmp_path / "run"))

    assert "paper, push-indicator, push-none, push-visual" in line


def test_fit_trains_a_recipe_file(recipe: Recipe, data_folder: Path, tmp_path: Path) -> None:
    """A recipe by path leaves a finished run and says what comes next."""
    path, run = tmp_path / "mine.toml", tmp_path / "run"
    fields = replace(recipe, epochs=1).record()
    path.write_text("".join(f"{key} = {value!r}\n" for key, value in fields.items()), encoding="utf-8")

    result = cazsl_train("fit", path, "--data", data_folder, "--run", run)

    assert result.exit_code == 0
    assert result.stdout == f"weights and metrics are in {run}; next: cazsl-train evaluate {run} --data {data_folder}\n"
    assert load_run(run)[0] == replace(recipe, epochs=1)


def test_evaluate_prints_the_figures_of_the_held_out_objects(data_folder: Path, indicator_run: Path) -> None:
    """Method, data and figures, under their names, and the next step."""
    held_out = Samples.of(read_folder(data_folder).select(different_objects().test), ContextKind.INDICATOR)
    figures = evaluate(load_run(indicator_run)[1], held_out)

    result = cazsl_train("evaluate", indicator_run, "--data", data_folder)

    title, names, numbers, following = result.stdout.splitlines()
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
    assert following == f"next: cazsl-train publish {indicator_run} --data {data_folder}"


@pytest.mark.parametrize("command", ["evaluate", "publish"])
def test_an_unfinished_run_is_named(data_folder: Path, indicator_run: Path, tmp_path: Path, command: str) -> None:
    """One line names the run and the command that finishes it."""
    run = tmp_path / "run"
    shutil.copytree(indicator_run, run)
    (run / WEIGHTS_FILE).unlink()

    line = sole_line(cazsl_train(command, run, "--data", data_folder))
    assert str(run) in line
    assert "cazsl-train fit" in line


def test_publish_makes_a_version_and_its_champion(data_folder: Path, none_run: Path, tmp_path: Path) -> None:
    """The first version serves at once; what serves is replaced by a promotion, which the last line names."""
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
    """It is served by its number only."""
    registry = Registry(tmp_path / "models")
    result = cazsl_train("publish", none_run, "--data", data_folder, "--registry", registry.root, "--no-alias")

    assert result.exit_code == 0
    assert registry.versions("push-none") == [1]
    assert registry.aliases("push-none") == {}


def test_a_model_of_all_objects_is_published_with_the_figures_of_a_run_that_held_some_out(
    recipe: Recipe, data_folder: Path, indicator_run: Path, tmp_path: Path
) -> None:
    """The same recipe on both set-ups; alone, a run on all objects is neither evaluated nor published."""
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
    """Figures on data that the run was not trained on must not get into its card; nothing is published."""
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


def test_images_draws_what_is_missing_and_says_what_models_will_see(tmp_path: Path) -> None:
    """The folder, the number of views, and a digest that changes with any of them."""
    names = omnipush_descriptors()
    write_views(tmp_path, names[:1], quiet=True)
    for name in names[2:]:  # stand-ins, so that one is left to draw
        (tmp_path / f"shape_{name}.npy").hardlink_to(tmp_path / f"shape_{names[0]}.npy")

    result = cazsl_train("images", tmp_path)

    assert result.exit_code == 0
    assert (tmp_path / f"shape_{names[1]}.npy").is_file()
    assert "250 views of 481 x 481" in result.output
    assert "next: cazsl-train images --gallery" in result.output


def test_images_of_another_kind_are_not_mixed_into_a_folder(tmp_path: Path) -> None:
    """One line that names the declaration."""
    write_views(tmp_path, (), quiet=True)

    assert "dataset.json declares another dataset" in sole_line(cazsl_train("images", tmp_path, "--camera"))


def test_images_can_draw_a_gallery_and_nothing_else(tmp_path: Path) -> None:
    """A PNG; no folder of views is touched."""
    result = cazsl_train("images", tmp_path / "views", "--gallery", tmp_path / "views.png")

    assert result.exit_code == 0
    assert (tmp_path / "views.png").read_bytes().startswith(b"\x89PNG")
    assert not (tmp_path / "views").exists()


def test_reproduce_writes_the_report_and_goes_on_where_it_stopped(data_folder: Path, tmp_path: Path) -> None:
    """Tables, plot and figures in a folder named as the experiment; a second time nothing is trained."""
    plywood = tmp_path / "plywood"
    declare_dataset(plywood, {"source": "synthetic plywood of a test"})
    for descriptor in different_surfaces().test:
        write_object(plywood, descriptor, np.full((2, 3), 0.05), np.full((2, 3), 0.01))
    (tmp_path / "abs").symlink_to(data_folder)
    arguments = ("reproduce", "different-surfaces", "--epochs", "1", "--seeds", "1", "--data", tmp_path / "abs")

    first = cazsl_train(*arguments, "--out", tmp_path / "out")

    folder = tmp_path / "out" / "different-surfaces"
    report = (folder / "README.md").read_text(encoding="utf-8")
    assert first.exit_code == 0, first.output
    assert first.stdout == f"next: read {folder / 'README.md'}; its plot is {folder / 'rmse.png'}\n"
    assert "**synthetic plywood of a test; synthetic pushes of a test**" in report
    command = f"cazsl-train reproduce different-surfaces --epochs 1 --seeds 1 --out {tmp_path / 'out'}"
    assert f"{command} --data {tmp_path / 'abs'}\n" in report
    runs = sorted(folder.glob("cells/*/*/*/metrics.jsonl"))
    before = {path: path.stat().st_mtime_ns for path in folder.rglob("cost.json")}
    assert len(runs) == len(before) == 6
    again = cazsl_train(*arguments, "--out", tmp_path / "out")
    assert again.stdout == first.stdout
    assert (folder / "README.md").read_text(encoding="utf-8") == report
    assert {path: path.stat().st_mtime_ns for path in folder.rglob("cost.json")} == before


@pytest.mark.parametrize("arguments", [(), ("--all", "gaussian-process")], ids=["neither", "both"])
def test_reproduce_wants_names_or_all(arguments: tuple[str, ...]) -> None:
    """It is a wrong use of the command, and the message has the names."""
    result = cazsl_train("reproduce", *arguments)

    assert result.exit_code == 2
    assert "gaussian-process, different-objects, different-surfaces, different-weights, or --all" in result.stderr


def test_reproduce_is_done_here_or_on_a_cluster() -> None:
    """Not both."""
    result = cazsl_train("reproduce", "gaussian-process", "--jobs", "2", "--ray", "auto")

    assert result.exit_code == 2
    assert "give either that or --ray" in result.stderr


def test_reproduce_on_a_cluster_that_is_not_there_is_one_line(data_folder: Path, tmp_path: Path) -> None:
    """With what would be accepted."""
    options = ("--seeds", "1", "--data", data_folder, "--out", tmp_path / "out", "--skip", "ANP")
    line = sole_line(cazsl_train("reproduce", "gaussian-process", "--ray", "127.0.0.1:1", *options))

    assert "--ray: received 127.0.0.1:1, where no Ray cluster answers; accepted is" in line


def test_reproduce_tells_of_cooling_and_passes_it_on(tmp_path: Path) -> None:
    """In the report's first lines, in its command, and in every recipe."""
    skipped = [word for method in METHODS if method != FCN for word in ("--skip", method)]
    options = ("--epochs", "4", "--seeds", "1", "--cooling", "2", "--jobs", "1")
    assert cazsl_train("reproduce", "gaussian-process", *options, "--out", tmp_path, *skipped).exit_code == 0

    text = (tmp_path / "gaussian-process/README.md").read_text()
    assert "falls to nothing over the last 2 epochs" in text
    assert "--epochs 4 --seeds 1 --out" in text
    assert " --cooling 2 " in text
    configs = [json.loads(path.read_text()) for path in tmp_path.rglob("config.json")]
    assert [config["recipe"]["cooling_epochs"] for config in configs] == [2]


def test_reproduce_cannot_cool_for_longer_than_it_trains() -> None:
    """One line that says how long may be."""
    result = cazsl_train("reproduce", "gaussian-process", "--epochs", "4", "--cooling", "5")
    assert result.exit_code == 2
    assert "--cooling: received 5; accepted is up to 4, the epochs of gaussian-process" in result.output


def test_reproduce_of_an_unknown_experiment_lists_those_that_exist() -> None:
    """The names that would have worked."""
    result = cazsl_train("reproduce", "different-planets")

    assert result.exit_code == 2
    assert "different-objects" in result.stderr


def test_reproduce_without_data_names_the_folder(tmp_path: Path) -> None:
    """One line, before anything is trained."""
    line = sole_line(cazsl_train("reproduce", "different-objects", "--data", tmp_path / "nowhere", "--out", tmp_path))

    assert str(tmp_path / "nowhere") in line
    assert not (tmp_path / "different-objects").exists()


def test_a_visual_model_is_fitted_evaluated_and_published_with_its_views(
    recipe: Recipe, data_folder: Path, tmp_path: Path
) -> None:
    """Views are named with --views, the next command repeats them, and the manifest has their convention."""
    views, path, run = tmp_path / "views", tmp_path / "push-visual.toml", tmp_path / "run"
    write_views(views, omnipush_descriptors(), quiet=True)
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


def test_publish_with_other_views_is_refused(
    recipe: Recipe, data_folder: Path, visual_run: Path, tmp_path: Path
) -> None:
    """The views are part of the data that a visual model was trained on."""
    write_views(tmp_path / "views", omnipush_descriptors(), quiet=True)
    options = ("--data", data_folder, "--views", tmp_path / "views", "--registry", tmp_path / "models")

    assert "other views with --views" in sole_line(cazsl_train("publish", visual_run, *options))
    assert not (tmp_path / "models").exists()
