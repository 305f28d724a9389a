"""Reproduction of an experiment: every cell and seed once, finished runs not again, results of saved weights."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

from service.bulk.executors import Executor, ProcessExecutor
from service.errors import DataError
from service.model.tensors import ContextKind
from tests.ray_cluster import NodeLossExecutor, TwoNodes
from training.fitting.evaluation import evaluate
from training.fitting.run_folder import CHECKPOINT_FILE, COST_FILE, METRICS_FILE, WEIGHTS_FILE, load_run
from training.fitting.samples import TrainingData
from training.omnipush.published import different_objects
from training.omnipush.pushes import Pushes
from training.paper.experiments import Cell, Experiment, experiments
from training.paper.reproduction import CELLS, data_reader, reproduce


@pytest.fixture(scope="module")
def small() -> Experiment:
    """Select four cells of different-objects."""
    found = experiments()["different-objects"]
    table = found.tables[0]
    rows = {name: table.paper[name] for name in ("ANP", "FCN", "FCN + CM", "FCN + CM + L2Reg")}
    return replace(found, tables=(replace(table, paper=rows),), precision="float32")


class RecordingReader:
    """A reader of training data that records the cells and seeds it is called with."""

    def __init__(self, pushes: Pushes) -> None:
        self.pushes, self.calls = pushes, set[tuple[Cell, int]]()

    def __call__(self, cell: Cell, seed: int) -> TrainingData:
        """Return the synthetic pushes."""
        self.calls.add((cell, seed))
        return TrainingData.of(different_objects(), ContextKind(cell.context), self.pushes)


def test_every_cell_and_seed_is_a_run_that_was_measured(
    small: Experiment, viewed_pushes: Pushes, tmp_path: Path
) -> None:
    """The results are those of the weights in each run's folder, on the held-out objects."""
    reader = RecordingReader(viewed_pushes)
    results = reproduce(small, reader, tmp_path, seeds=2, epochs=1, quiet=True)

    runs = [(result.cell, result.seed) for result in results]
    assert sorted(runs, key=str) == sorted([(cell, seed) for seed in (0, 1) for cell in small.cells], key=str)
    assert [cell.method for cell, _ in runs[-2:]] == ["ANP", "ANP"]  # the slowest method comes last
    assert reader.calls == {(result.cell, result.seed) for result in results}
    for result in results:
        run = tmp_path / CELLS / "different-objects" / result.cell.slug / f"seed-{result.seed}"
        recipe, network, origin = load_run(run)
        data = reader(result.cell, result.seed)
        assert recipe == small.recipe(result.cell, result.seed, epochs=1)
        assert (result.found, result.origin) == (evaluate(network, data.held_out), origin)
        assert result.cost == json.loads((run / COST_FILE).read_text(encoding="utf-8"))


def test_only_a_neural_process_is_shown_its_targets(small: Experiment, viewed_pushes: Pushes, tmp_path: Path) -> None:
    """Only the neural process has a result with leaked targets, and it differs from the result of its prior."""
    results = reproduce(small, RecordingReader(viewed_pushes), tmp_path, seeds=1, epochs=1, quiet=True)

    leaked = {result.cell.method: result.leaked for result in results if result.leaked is not None}
    assert list(leaked) == ["ANP"]
    assert leaked["ANP"] != results[0].found


def test_finished_runs_are_not_trained_again(small: Experiment, viewed_pushes: Pushes, tmp_path: Path) -> None:
    """A killed run is trained again with the same figures, and finished runs keep their records to the byte."""
    first = reproduce(small, RecordingReader(viewed_pushes), tmp_path, seeds=1, epochs=2, quiet=True)
    killed = tmp_path / CELLS / "different-objects" / "fcn" / "seed-0"
    for name in (CHECKPOINT_FILE, WEIGHTS_FILE, COST_FILE, METRICS_FILE):
        (killed / name).unlink()
    kept = [
        tmp_path / CELLS / "different-objects" / slug / "seed-0" / METRICS_FILE for slug in ("anp", "fcn-cm-indicator")
    ]
    before = [path.read_bytes() for path in kept]

    again = reproduce(small, RecordingReader(viewed_pushes), tmp_path, seeds=1, epochs=2, quiet=True)

    assert [result.found for result in again] == [result.found for result in first]
    assert [path.read_bytes() for path in kept] == before
    assert len((killed / METRICS_FILE).read_text(encoding="utf-8").splitlines()) == 2


def test_all_results_so_far_are_reported_after_every_run(
    small: Experiment, viewed_pushes: Pushes, tmp_path: Path
) -> None:
    """The callback gets all results so far after every run, known ones included, in the order of the runs."""
    reader, seen = RecordingReader(viewed_pushes), list[list[str]]()
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
        on_results=lambda results: seen.append([result.cell.method for result in results]),
    )

    assert seen == [["FCN", "FCN + CM"], ["FCN", "FCN + CM", "FCN + CM + L2Reg"]]


def test_known_results_are_not_trained_again(small: Experiment, viewed_pushes: Pushes, tmp_path: Path) -> None:
    """Known results are taken without a run folder, and only the other cells are trained."""
    reader = RecordingReader(viewed_pushes)
    first = reproduce(small.without(["ANP"]), reader, tmp_path / "then", seeds=1, epochs=1, quiet=True)
    known = {(result.cell, result.seed): result for result in first}

    found = reproduce(small, reader, tmp_path / "now", seeds=1, epochs=1, quiet=True, known=known)

    assert [result for result in found if result.cell.method != "ANP"] == first
    assert [path.parent.name for path in (tmp_path / "now" / CELLS).glob("*/*/seed-*")] == ["anp"]


def test_known_figures_of_other_data_are_refused(small: Experiment, viewed_pushes: Pushes, tmp_path: Path) -> None:
    """Known results of other data are refused before any training."""
    reader = RecordingReader(viewed_pushes)
    (first, *_) = reproduce(small, reader, tmp_path / "then", seeds=1, epochs=1, quiet=True)
    other = replace(first, origin={"source": "elsewhere", "sha256": "1" * 64})

    with pytest.raises(DataError, match=r"seed 0: the known figures are of .*elsewhere.*; give the data .*--plan ring"):
        reproduce(small, reader, tmp_path / "now", seeds=1, epochs=1, quiet=True, known={(first.cell, 0): other})

    assert not (tmp_path / "now").exists()


def test_another_number_of_epochs_needs_another_folder(
    small: Experiment, viewed_pushes: Pushes, tmp_path: Path
) -> None:
    """A folder with runs of another number of epochs is refused, so that no table mixes them."""
    reproduce(small, RecordingReader(viewed_pushes), tmp_path, seeds=1, epochs=1, quiet=True)

    with pytest.raises(DataError, match="records another run"):
        reproduce(small, RecordingReader(viewed_pushes), tmp_path, seeds=1, epochs=2, quiet=True)


def test_missing_data_are_named_before_any_training(tmp_path: Path, data_folder: Path) -> None:
    """Missing views are named before any training."""
    experiment = experiments()["different-objects"]
    read = data_reader(experiment, data_folder, tmp_path / "no-views")

    with pytest.raises(DataError, match="no-views is not a folder of top-down views"):
        reproduce(experiment, read, tmp_path / "out", seeds=1, epochs=1, quiet=True)

    assert not (tmp_path / "out").exists()


def test_pushes_are_read_once_for_the_cells_that_share_them(data_folder: Path) -> None:
    """Cells that share their data get the same object, for all methods and seeds."""
    experiment = experiments()["different-objects"]
    read = data_reader(experiment, data_folder)
    masked, regularised = (Cell("different-objects", f"FCN + CM{more}", "indicator") for more in ("", " + L2Reg"))

    assert read(masked, 0) is read(regularised, 1)


def test_each_repeat_of_the_regression_draws_its_own_processes() -> None:
    """The methods of the regression share the processes of a seed, and each seed has its own."""
    experiment = experiments()["gaussian-process"]
    read = data_reader(experiment, Path("not needed"))
    first, other = experiment.cells[:2]

    assert read(first, 0) is read(other, 0)
    assert read(first, 0).origin != read(first, 1).origin


@pytest.fixture(scope="module")
def serial_runs(small: Experiment, viewed_pushes: Pushes, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Train the runs of two seeds in this process. Tests must not change them."""
    folder = tmp_path_factory.mktemp("serial_runs")
    reproduce(small, RecordingReader(viewed_pushes), folder, seeds=2, epochs=2, quiet=True)
    return folder


def reproduce_two_seeds(
    small: Experiment, pushes: Pushes, folder: Path, executor: Executor | None = None
) -> list[object]:
    """Reproduce two seeds and return the results without their cost."""
    results = reproduce(small, RecordingReader(pushes), folder, seeds=2, epochs=2, quiet=True, executor=executor)
    return [replace(result, cost={}) for result in results]


def files_of_the_seed(folder: Path) -> dict[str, bytes]:
    """Read every file that depends on the seed alone: neither cost nor checkpoint, which records the cost too."""
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file() and path.name not in (COST_FILE, CHECKPOINT_FILE)
    }


def test_processes_make_the_same_runs_to_the_bit(
    small: Experiment, viewed_pushes: Pushes, serial_runs: Path, tmp_path: Path
) -> None:
    """Worker processes give the same results, weights and records as this process, in the same order."""
    found = reproduce_two_seeds(small, viewed_pushes, tmp_path, ProcessExecutor(2))

    assert found == reproduce_two_seeds(small, viewed_pushes, serial_runs)
    assert files_of_the_seed(tmp_path) == files_of_the_seed(serial_runs)


def test_a_cluster_that_loses_a_node_makes_the_same_runs_to_the_bit(
    small: Experiment, viewed_pushes: Pushes, serial_runs: Path, two_nodes: TwoNodes, tmp_path: Path
) -> None:
    """A cluster that loses a node during training returns whole folders, and no run is left to train."""
    (tmp_path / "marks").mkdir()
    executor = NodeLossExecutor(two_nodes, tmp_path / "marks", held=4)
    found = reproduce_two_seeds(small, viewed_pushes, tmp_path / "out", executor)

    assert executor.run_twice() == 1
    assert found == reproduce_two_seeds(small, viewed_pushes, serial_runs)
    assert files_of_the_seed(tmp_path / "out") == files_of_the_seed(serial_runs)
    before = {path: path.read_bytes() for path in (tmp_path / "out").rglob(COST_FILE)}
    assert len(before) == 8
    assert reproduce_two_seeds(small, viewed_pushes, tmp_path / "out") == found
    assert {path: path.read_bytes() for path in before} == before


def test_a_run_that_fails_is_named(small: Experiment, viewed_pushes: Pushes, tmp_path: Path) -> None:
    """The error of a failed run names its set-up, row and seed, whichever worker trained it."""
    killed = tmp_path / CELLS / "different-objects" / "fcn" / "seed-0"
    killed.mkdir(parents=True)
    (killed / "config.json").write_text("{}", encoding="utf-8")

    with pytest.raises(DataError, match=r"^different-objects, fcn, seed 0: .* records another run"):
        reproduce_two_seeds(small, viewed_pushes, tmp_path, ProcessExecutor(2))


def test_an_unforeseen_error_names_the_run(small: Experiment, viewed_pushes: Pushes, tmp_path: Path) -> None:
    """An unforeseen error keeps its type and names the run in a note."""
    killed = tmp_path / CELLS / "different-objects" / "fcn" / "seed-0"
    killed.mkdir(parents=True)
    (killed / CHECKPOINT_FILE).write_bytes(b"torn")

    with pytest.raises(Exception) as caught:  # noqa: PT011  # torch's own, whatever it is
        reproduce_two_seeds(small, viewed_pushes, tmp_path)

    assert caught.value.__notes__ == ["while training different-objects, fcn, seed 0"]
