"""Rebuilding of tables: a report per experiment, with the command that repeats it."""

from dataclasses import replace
from pathlib import Path

import pytest

from service.bulk.executors import choose_executor
from service.errors import DataError
from training.networks.methods import FCN, METHODS
from training.paper.experiments import GAUSSIAN_PROCESS
from training.paper.options import ReproductionOptions
from training.paper.rebuild import rebuild_tables
from training.paper.report import REPORT_FILE


@pytest.fixture
def options(tmp_path: Path) -> ReproductionOptions:
    """Options of one short run of one row of the regression."""
    skipped = tuple(method for method in METHODS if method != FCN)
    return ReproductionOptions(
        names=(GAUSSIAN_PROCESS,), epochs=1, seeds=1, skip=skipped, out=tmp_path / "out", data=tmp_path
    )


def test_a_report_is_written_for_each_experiment(options: ReproductionOptions) -> None:
    """The report of an experiment is in its folder and shows its command."""
    (path,) = rebuild_tables(options, choose_executor(1))

    assert path == options.out / GAUSSIAN_PROCESS / REPORT_FILE
    assert options.command(options.experiments()[0]) in path.read_text(encoding="utf-8")


def test_known_runs_are_not_repeated(options: ReproductionOptions, tmp_path: Path) -> None:
    """The runs in a figures file of the same options are taken over without a run folder."""
    (path,) = rebuild_tables(options, choose_executor(1))
    again = replace(options, known=path.parent / "figures.json", out=tmp_path / "again")
    (repeated,) = rebuild_tables(again, choose_executor(1))

    assert repeated.is_file()
    assert not list((tmp_path / "again").rglob("metrics.jsonl"))


def test_known_runs_of_other_options_are_refused(options: ReproductionOptions) -> None:
    """The error about a figures file of another number of epochs names the file."""
    (path,) = rebuild_tables(options, choose_executor(1))
    other = replace(options, known=path.parent / "figures.json", epochs=2)

    with pytest.raises(DataError, match=r"figures\.json"):
        list(rebuild_tables(other, choose_executor(1)))
