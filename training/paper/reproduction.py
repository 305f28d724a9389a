"""Reproduction of an experiment of the paper: every cell and seed is a run with a folder of its own.

Finished runs are not repeated. Runs are independent and use one thread each, so their results do not depend on the
executor. Training data are sent once to each worker process. A worker that does not share this disk receives the files
of the run folder and returns those that changed.
"""

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

import torch
from tqdm import tqdm

from service.bulk.executors import Executor, SerialExecutor
from service.errors import CazslError, DataError
from service.model.tensors import ContextKind
from training.fitting.evaluation import Evaluation, evaluate
from training.fitting.recipe import SET_UPS, Recipe
from training.fitting.run_folder import COST_FILE
from training.fitting.samples import TrainingData, read_training_data
from training.fitting.training_loop import fit
from training.networks.methods import METHODS
from training.networks.neural_process import NeuralProcess
from training.paper import gaussian_process
from training.paper.experiments import GAUSSIAN_PROCESS, Cell, Experiment
from training.paper.run_transfer import RunFiles, changed, pack, unpack

CELLS: Final = "cells"
DataReader = Callable[[Cell, int], TrainingData]


@dataclass(frozen=True)
class Result:
    """Result of one training of a cell, measured on its held-out samples."""

    cell: Cell
    seed: int
    found: Evaluation
    leaked: Evaluation | None  # of a neural process that is given the targets, as in the published evaluation
    cost: dict[str, str | float]  # seconds, device, precision
    origin: dict[str, str]


@dataclass(frozen=True)
class Run:
    """Run: one training of a cell, as a task for an executor."""

    cell: Cell
    seed: int
    recipe: Recipe
    data_index: int  # in the data that every worker has
    folder: Path
    files: RunFiles | None = None  # content of the folder, for workers that do not share this disk

    @property
    def name(self) -> str:
        """Return a name for people."""
        return f"{self.cell.set_up}, {self.cell.slug}, seed {self.seed}"


@dataclass(frozen=True)
class Trainer:
    """Train or continue each run of a worker process, and evaluate it."""

    data: list[TrainingData]
    quiet: bool

    def __call__(self, run: Run) -> tuple[Result, RunFiles]:
        """Train a run. Return its result, and the files to write into its folder on the caller's disk.

        Raises:
            DataError: the run cannot be trained. The message names the run.
        """
        try:
            if run.files is None:
                return self._train(run, run.folder), {}
            with TemporaryDirectory() as folder:
                unpack(run.files, Path(folder))
                return self._train(run, Path(folder)), changed(run.files, Path(folder))
        except CazslError as error:
            raise DataError(f"{run.name}: {error}") from error
        except Exception as error:  # an unforeseen error keeps its traceback and names the run
            error.add_note(f"while training {run.name}")
            raise

    def _train(self, run: Run, folder: Path) -> Result:
        data = self.data[run.data_index]
        with one_thread():
            network = fit(run.recipe, data, folder, self.quiet, bar=1)
            leaked = evaluate(network, data.held_out, leak=True) if isinstance(network, NeuralProcess) else None
            found = evaluate(network, data.held_out)
        cost = json.loads((folder / COST_FILE).read_text(encoding="utf-8"))
        return Result(run.cell, run.seed, found, leaked, cost, data.origin)


def trainer(shared: tuple[list[TrainingData], bool]) -> Trainer:
    """Prepare a worker process for its runs."""
    return Trainer(*shared)


@contextmanager
def one_thread() -> Iterator[None]:
    """Keep torch on one thread: figures then depend on the seed alone, to the bit, and runs share the cores evenly."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def reproduce(
    experiment: Experiment,
    read: DataReader,
    folder: Path,
    seeds: int,
    epochs: int,
    quiet: bool = False,
    executor: Executor | None = None,
    known: Mapping[tuple[Cell, int], Result] | None = None,
    on_results: Callable[[list[Result]], object] = lambda _: None,
) -> list[Result]:
    """Train and evaluate every cell with every seed, or continue the runs in ``folder``.

    Runs are ordered seed by seed, so that all cells have a first result early. The neural process comes last, because
    it takes ten times as long as any other method.

    Args:
        experiment: the cells to train.
        read: reads the training data of a cell and seed.
        folder: receives a folder per run.
        seeds: number of runs per cell.
        epochs: per run.
        quiet: show no progress.
        executor: trains the runs, by default in this process.
        known: results of an earlier reproduction, which are not trained again.
        on_results: called after every run, with all results so far.

    Raises:
        DataError: data are missing, or a folder holds runs of other data, recipes or code.
        WorkforceError: the workers cannot be started, or were lost.
    """
    executor = executor or SerialExecutor()
    runs, data = _plan(experiment, read, folder, seeds, epochs)
    results = _select_known(runs, data, known or {})
    left = [run for run in runs if (run.cell, run.seed) not in results]
    with (
        executor.start(trainer, (data, quiet or not executor.serial)) as pool,
        tqdm(total=len(runs), initial=len(results), desc=experiment.name, unit="run", disable=quiet) as progress,
    ):

        def tasks() -> Iterator[Run]:
            for run in left:
                progress.set_postfix_str(run.name)
                yield run if executor.shares_disk else replace(run, files=pack(run.folder))

        for run, (result, files) in pool.as_completed(tasks()):
            if files:
                unpack(files, run.folder)
            results[run.cell, run.seed] = result
            progress.update()
            on_results(_in_order(runs, results))
    return _in_order(runs, results)


def _in_order(runs: Sequence[Run], results: Mapping[tuple[Cell, int], Result]) -> list[Result]:
    """Return the results in the planned order of their runs."""
    return [results[run.cell, run.seed] for run in runs if (run.cell, run.seed) in results]


def _select_known(
    runs: Sequence[Run], data: Sequence[TrainingData], known: Mapping[tuple[Cell, int], Result]
) -> dict[tuple[Cell, int], Result]:
    """Select the known results of planned runs.

    Raises:
        DataError: a known result was made from other data.
    """
    selected = {(run.cell, run.seed): known[run.cell, run.seed] for run in runs if (run.cell, run.seed) in known}
    for run in runs:
        result = selected.get((run.cell, run.seed))
        if result is not None and result.origin != data[run.data_index].origin:
            raise DataError(
                f"{run.name}: the known figures are of {result.origin}, the data here {data[run.data_index].origin}; "
                "give the data that they are of, or leave the known figures out (simulated pushes whose source has no "
                "plan are those of cazsl-train simulate --plan ring: --data data/simulated/abs)"
            )
    return selected


def _plan(
    experiment: Experiment, read: DataReader, folder: Path, seeds: int, epochs: int
) -> tuple[list[Run], list[TrainingData]]:
    """Plan all runs in their order, and read their distinct data, so that missing data are named before training."""
    wanted = [(cell, seed) for seed in range(seeds) for cell in experiment.cells]
    wanted.sort(key=lambda run: METHODS[run[0].method].neural_process)
    indices: dict[int, int] = {}
    data: list[TrainingData] = []
    runs = []
    for cell, seed in wanted:
        found = read(cell, seed)
        if id(found) not in indices:
            indices[id(found)] = len(data)
            data.append(found)
        path = folder / CELLS / cell.set_up / cell.slug / f"seed-{seed}"
        runs.append(Run(cell, seed, experiment.recipe(cell, seed, epochs), indices[id(found)], path))
    return runs, data


def data_reader(experiment: Experiment, data_folder: Path, views: Path | None = None) -> DataReader:
    """Return a reader of training data by cell and seed, which reads data once for all cells that share them."""

    @cache
    def pushes(set_up: str, context: str) -> TrainingData:
        return read_training_data(SET_UPS[set_up](), ContextKind(context), data_folder, views)

    draw = cache(gaussian_process.draw_training_data)  # each seed draws new Gaussian processes as well as new weights

    def read(cell: Cell, seed: int) -> TrainingData:
        return draw(seed) if experiment.name == GAUSSIAN_PROCESS else pushes(cell.set_up, cell.context)

    return read
