"""``cazsl-train reproduce``: reports, the command that repeats them, and options that contradict each other."""

import json
import shlex
from pathlib import Path

import numpy as np
import pytest

from tests.training.command_line import cazsl_train, sole_line
from training.cli.reproduction import reproduce
from training.networks.methods import FCN, METHODS
from training.omnipush.declaration import declare_dataset
from training.omnipush.published import different_surfaces
from training.omnipush.pushes import write_object
from training.paper.options import ReproductionOptions


def test_reproduce_writes_the_report_and_continues(data_folder: Path, tmp_path: Path) -> None:
    """Tables, plot and figures are written into the experiment's folder, and a second call trains no run again."""
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
def test_reproduce_needs_names_or_all(arguments: tuple[str, ...]) -> None:
    """Neither names nor --all, or both, is a usage error that lists the experiments."""
    result = cazsl_train("reproduce", *arguments)

    assert result.exit_code == 2
    assert "gaussian-process, different-objects, different-surfaces, different-weights, or --all" in result.stderr


def test_reproduce_runs_here_or_on_a_cluster() -> None:
    """--jobs and --ray together are a usage error."""
    result = cazsl_train("reproduce", "gaussian-process", "--jobs", "2", "--ray", "auto")

    assert result.exit_code == 2
    assert "give either that or --ray" in result.stderr


def test_an_unreachable_cluster_is_one_line(data_folder: Path, tmp_path: Path) -> None:
    """The error about an unreachable Ray cluster has its address and the accepted ones."""
    options = ("--seeds", "1", "--data", data_folder, "--out", tmp_path / "out", "--skip", "ANP")
    line = sole_line(cazsl_train("reproduce", "gaussian-process", "--ray", "127.0.0.1:1", *options))

    assert "--ray: no Ray cluster answers at 127.0.0.1:1; give auto or the HOST:PORT" in line


def test_reproduce_reports_cooling_and_passes_it_on(tmp_path: Path) -> None:
    """Cooling is in the report's first lines, in its command, and in every recipe."""
    skipped = [word for method in METHODS if method != FCN for word in ("--skip", method)]
    options = ("--epochs", "4", "--seeds", "1", "--cooling", "2", "--jobs", "1")
    assert cazsl_train("reproduce", "gaussian-process", *options, "--out", tmp_path, *skipped).exit_code == 0

    text = (tmp_path / "gaussian-process/README.md").read_text()
    assert "falls to 0 over the last 2 epochs" in text
    assert "--epochs 4 --seeds 1 --out" in text
    assert " --cooling 2 " in text
    configs = [json.loads(path.read_text()) for path in tmp_path.rglob("config.json")]
    assert [config["recipe"]["cooling_epochs"] for config in configs] == [2]


def test_reproduce_cannot_cool_for_longer_than_it_trains() -> None:
    """The error about too long a cooling has the largest number of epochs."""
    result = cazsl_train("reproduce", "gaussian-process", "--epochs", "4", "--cooling", "5")
    assert result.exit_code == 2
    assert "--cooling: received 5; give at most 4, the epochs of gaussian-process" in result.output


def test_reproduce_of_an_unknown_experiment_lists_those_that_exist() -> None:
    """The error about an unknown experiment lists the experiments."""
    result = cazsl_train("reproduce", "different-planets")

    assert result.exit_code == 2
    assert "different-objects" in result.stderr


def test_reproduce_without_data_names_the_folder(tmp_path: Path) -> None:
    """The error about a missing folder of data names it before any training."""
    line = sole_line(cazsl_train("reproduce", "different-objects", "--data", tmp_path / "nowhere", "--out", tmp_path))

    assert str(tmp_path / "nowhere") in line
    assert not (tmp_path / "different-objects").exists()


def test_published_commands_are_rendered_unchanged(project_root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each command in a published page, parsed and rendered again, is the same text."""
    monkeypatch.chdir(project_root)
    documents = [json.loads(path.read_text(encoding="utf-8")) for path in Path("docs/results").glob("*/figures.json")]
    commands = [document["command"] for document in documents if "experiment" in document]

    assert len(commands) == 8
    for text in commands:
        parsed = reproduce.make_context("reproduce", shlex.split(text)[2:]).params
        options = ReproductionOptions(data=parsed.pop("folder"), **parsed)
        assert [options.command(experiment) for experiment in options.experiments()] == [text]
