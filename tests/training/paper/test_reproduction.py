"""Reproducing an experiment: every cell and seed once, finished runs not again, figures that are those of the runs."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

from service.bulk.executors import Executor, ProcessExecutor
from service.errors import DataError
from service.model.tensors import ContextKind
from tests.clusters import NodeLossExecutor, TwoNodes
from training.fitting.evaluation import evaluate
from training.fitting.run_folder import CHECKPOINT_FILE, COST_FILE, METRICS_FILE, WEIGHTS_FILE, load_run
from training.fitting.samples import TrainingData
from training.omnipush.published import different_objects
from training.omnipush.pushes import Pushes
from training.paper.experiments import Cell, Experiment, experiments
from training.paper.reproduction import CELLS, data_reader, reproduce


@pytest.fixture(scope="module")
def small() -> Experiment:
    """Four cells of different-objects."""
    found = experiments()["different-objects"]
    table = found.tables[0]
    rows = {name: table.paper[name] for name in ("ANP", "FCN", "FCN + CM", "FCN + CM + L2Reg")}
    return replace(found, tables=(replace(table, paper=rows),), precision="float32")


class Reader:
    """Hands out data and remembers for whom."""

    def __init__(self, pushes: Pushes) -> None:
        self.pushes, self.asked = pushes, set[tuple[Cell, int]]()

    def __call__(self, cell: Cell, seed: int) -> TrainingData:
        """The synthetic pushes."""
        self.asked.add((cell, seed))
        return TrainingData.of(different_objects(), ContextKind(cell.context), self.pushes)


def test_every_cell_and_seed_is_a_run_that_was_measured(
    small: Experiment, viewed_pushes: Pushes, tmp_path: Path
) -> None:
    """The figures are those of the weights in its folder, on the objects held out."""
    reader = Reader(viewed_pushes)
    results = reproduce(small, reader, tmp_path, seeds=2, epochs=1, quiet=True)

    runs = [(result.cell, result.seed) for result in results]
    assert sorted(runs, key=str) == sorted([(cell, seed) for seed in (0, 1) for cell in small.cells], key=str)
    assert [cell.method for cell, _ in runs[-2:]] == ["ANP", "ANP"]  # the dearest come last
    assert reader.asked == {(result.cell, result.seed) for result in results}
    for result in results:
        run = tmp_path / CELLS / "different-objects" / result.cell.slug / f"seed-{result.seed}"
        recipe, network, origin = load_run(run)
        data = reader(result.cell, result.seed)
        assert recipe == small.recipe(result.cell, result.seed, epochs=1)
        assert (result.found, result.origin) == (evaluate(network, data.held_out), origin)
        assert result.cost == json.loads((run / COST_FILE).read_text(encoding="utf-8"))


def test_only_a_neural_process_is_shown_its_targets(small: Experiment, viewed_pushes: Pushes, tmp_path: Path) -> None:
    """And what it says then is not what it says from its prior."""
    results = reproduce(small, Reader(viewed_pushes), tmp_path, seeds=1, epochs=1, quiet=True)

    leaked = {result.cell.method: result.leaked for result in results if result.leaked is not None}
    assert list(leaked) == ["ANP"]
    assert leaked["ANP"] != results[0].found


def test_what_is_finished_is_not_done_again(small: Experiment, viewed_pushes: Pushes, tmp_path: Path) -> None:
    """A run that was killed is made, those that were finished keep their records to the byte; figures are the same."""
    first = reproduce(small, Reader(viewed_pushes), tmp_path, seeds=1, epochs=2, quiet=True)
    killed = tmp_path / CELLS / "different-objects" / "fcn" / "seed-0"
    for name in (CHECKPOINT_FILE, WEIGHTS_FILE, COST_FILE, METRICS_FILE):
        (killed / name).unlink()
    kept = [
        tmp_path / CELLS / "different-objects" / slug / "seed-0" / METRICS_FILE for slug in ("anp", "fcn-cm-indicator")
    ]
    before = [path.read_bytes() for path in kept]

    again = reproduce(small, Reader(viewed_pushes), tmp_path, seeds=1, epochs=2, quiet=True)

    assert [result.found for result in again] == [result.found for result in first]
    assert [path.read_bytes() for path in kept] == before
    assert len((killed / METRICS_FILE).read_text(encoding="utf-8").splitlines()) == 2


def test_who_looks_sees_all_results_so_far_after_every_run(
    small: Experiment, viewed_pushes: Pushes, tmp_path: Path
) -> None:
    """Those that were known among them, in the order of the runs."""
    reader, seen = Reader(viewed_pushes), list[list[str]]()
    (first, *_) = reproduce(small.without(["ANP"]), reader, tmp_path / "then", seeds=1, epochs=1, quiet=True)

    known = {(first.cell, 0): first}
    reproduce(
        small.without(["ANP"]),
        reader,
        tmp_path / "now",
        seeds=1,
        epochs=1,
        quiet=True,
        known=known,
        look=lambda results: seen.append([result.cell.method for result in results]),
    )

    assert seen == [["FCN", "FCN + CM"], ["FCN", "FCN + CM", "FCN + CM + L2Reg"]]


def test_what_is_known_is_taken_and_the_rest_is_trained(
    small: Experiment, viewed_pushes: Pushes, tmp_path: Path
) -> None:
    """No folder is made for a run whose figures were brought along; rows that were left out then are added."""
    reader = Reader(viewed_pushes)
    first = reproduce(small.without(["ANP"]), reader, tmp_path / "then", seeds=1, epochs=1, quiet=True)
    known = {(result.cell, result.seed): result for result in first}

    found = reproduce(small, reader, tmp_path / "now", seeds=1, epochs=1, quiet=True, known=known)

    assert [result for result in found if result.cell.method != "ANP"] == first
    assert [path.parent.name for path in (tmp_path / "now" / CELLS).glob("*/*/seed-*")] == ["anp"]


def test_known_figures_of_other_data_are_refused(small: Experiment, viewed_pushes: Pushes, tmp_path: Path) -> None:
    """Before anything is trained."""
    reader = Reader(viewed_pushes)
    (first, *_) = reproduce(small, reader, tmp_path / "then", seeds=1, epochs=1, quiet=True)
    other = replace(first, origin={"source": "elsewhere", "sha256": "1" * 64})

    with pytest.raises(DataError, match=r"seed 0: the known figures are of .*elsewhere.*; bring the data"):
        reproduce(small, reader, tmp_path / "now", seeds=1, epochs=1, quiet=True, known={(first.cell, 0): other})

    assert not (tmp_path / "now").exists()


def test_another_number_of_epochs_needs_another_folder(
    small: Experiment, viewed_pushes: Pushes, tmp_path: Path
) -> None:
    """A table never mixes runs of different length."""
    reproduce(small, Reader(viewed_pushes), tmp_path, seeds=1, epochs=1, quiet=True)

    with pytest.raises(DataError, match="records another run"):
        reproduce(small, Reader(viewed_pushes), tmp_path, seeds=1, epochs=2, quiet=True)


def test_missing_data_are_said_before_any_training(tmp_path: Path, data_folder: Path) -> None:
    """No views beside the folder: nothing is trained first."""
    experiment = experiments()["different-objects"]
    read = data_reader(experiment, data_folder, tmp_path / "no-views")

    with pytest.raises(DataError, match="no-views is not a folder of top-down views"):
        reproduce(experiment, read, tmp_path / "out", seeds=1, epochs=1, quiet=True)

    assert not (tmp_path / "out").exists()


def test_pushes_are_read_once_for_the_cells_that_share_them(data_folder: Path) -> None:
    """The same object again, whatever the method and seed."""
    experiment = experiments()["different-objects"]
    read = data_reader(experiment, data_folder)
    masked, regularised = (Cell("different-objects", f"FCN + CM{more}", "indicator") for more in ("", " + L2Reg"))

    assert read(masked, 0) is read(regularised, 1)


def test_each_repeat_of_the_regression_draws_its_own_processes() -> None:
    """Shared by its methods, different from the next."""
    experiment = experiments()["gaussian-process"]
    read = data_reader(experiment, Path("not needed"))
    first, other = experiment.cells[:2]

    assert read(first, 0) is read(other, 0)
    assert read(first, 0).origin != read(first, 1).origin


@pytest.fixture(scope="module")
def alone(small: Experiment, viewed_pushes: Pushes, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The runs of two seeds, trained by this process; not to be changed."""
    folder = tmp_path_factory.mktemp("alone")
    reproduce(small, Reader(viewed_pushes), folder, seeds=2, epochs=2, quiet=True)
    return folder


def measured(small: Experiment, pushes: Pushes, folder: Path, executor: Executor | None = None) -> list[object]:
    """Figures of two seeds, without what their training took."""
    results = reproduce(small, Reader(pushes), folder, seeds=2, epochs=2, quiet=True, executor=executor)
    return [replace(result, cost={}) for result in results]


def files(folder: Path) -> dict[str, bytes]:
    """Every file of every run that is the seed's alone: not what it took, nor a checkpoint, which says so as well."""
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file() and path.name not in (COST_FILE, CHECKPOINT_FILE)
    }


def test_processes_make_the_same_runs_to_the_bit(
    small: Experiment, viewed_pushes: Pushes, alone: Path, tmp_path: Path
) -> None:
    """Figures, weights and records, in the same order."""
    found = measured(small, viewed_pushes, tmp_path, ProcessExecutor(2))

    assert found == measured(small, viewed_pushes, alone)
    assert files(tmp_path) == files(alone)


def test_a_cluster_that_loses_a_node_makes_the_same_runs_to_the_bit(
    small: Experiment, viewed_pushes: Pushes, alone: Path, two_nodes: TwoNodes, tmp_path: Path
) -> None:
    """Half-way, while both nodes train; the folders come home whole, and nothing is left to do."""
    (tmp_path / "marks").mkdir()
    executor = NodeLossExecutor(two_nodes, tmp_path / "marks", held=4)
    found = measured(small, viewed_pushes, tmp_path / "out", executor)

    assert executor.run_twice() == 1
    assert found == measured(small, viewed_pushes, alone)
    assert files(tmp_path / "out") == files(alone)
    before = {path: path.read_bytes() for path in (tmp_path / "out").rglob(COST_FILE)}
    assert len(before) == 8
    assert measured(small, viewed_pushes, tmp_path / "out") == found
    assert {path: path.read_bytes() for path in before} == before


def test_a_run_that_fails_is_named(small: Experiment, viewed_pushes: Pushes, tmp_path: Path) -> None:
    """Set-up, row and seed, whoever trained it."""
    killed = tmp_path / CELLS / "different-objects" / "fcn" / "seed-0"
    killed.mkdir(parents=True)
    (killed / "config.json").write_text("{}", encoding="utf-8")

    with pytest.raises(DataError, match=r"^different-objects, fcn, seed 0: .* records another run"):
        measured(small, viewed_pushes, tmp_path, ProcessExecutor(2))


def test_what_nobody_foresaw_names_the_run_too(small: Experiment, viewed_pushes: Pushes, tmp_path: Path) -> None:
    """The error is seen whole, with a note."""
    killed = tmp_path / CELLS / "different-objects" / "fcn" / "seed-0"
    killed.mkdir(parents=True)
    (killed / CHECKPOINT_FILE).write_bytes(b"torn")

    with pytest.raises(Exception) as caught:  # noqa: PT011  # torch's own, whatever it is
        measured(small, viewed_pushes, tmp_path)

    assert caught.value.__notes__ == ["while training different-objects, fcn, seed 0"]
