"""Run an experiment of the paper: every cell and seed is a run folder, and what is finished is not done again.

Runs know nothing of each other and take one thread each, so that any executor makes the same of them. Data go once to
each of its processes; a machine that does not see this disk is sent what the run folder holds and sends back what
changed.
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
from training.paper.run_transfer import Parcel, changed, pack, unpack

CELLS: Final = "cells"
DataReader = Callable[[Cell, int], TrainingData]


@dataclass(frozen=True)
class Result:
    """One training of a cell, measured on its held-out samples."""

    cell: Cell
    seed: int
    found: Evaluation
    leaked: Evaluation | None  # of a neural process that is shown the targets, as the published evaluation does
    cost: dict[str, str | float]  # seconds, device, precision
    origin: dict[str, str]


@dataclass(frozen=True)
class Run:
    """One training of a cell: what whoever does it is told."""

    cell: Cell
    seed: int
    recipe: Recipe
    data: int  # its place among the data that everybody was sent
    folder: Path
    sent: Parcel | None = None  # what the folder holds, for who does not see it

    @property
    def name(self) -> str:
        """For people."""
        return f"{self.cell.set_up}, {self.cell.slug}, seed {self.seed}"


@dataclass(frozen=True)
class Trainer:
    """What a process does with each run: train it, or go on with it, and measure it."""

    data: list[TrainingData]
    quiet: bool

    def __call__(self, run: Run) -> tuple[Result, Parcel]:
        """The run's figures, and the files that its folder at home does not have yet.

        Raises:
            DataError: it cannot be trained; says which it is.
        """
        try:
            if run.sent is None:
                return self._trained(run, run.folder), {}
            with TemporaryDirectory() as folder:
                unpack(run.sent, Path(folder))
                return self._trained(run, Path(folder)), changed(run.sent, Path(folder))
        except CazslError as error:
            raise DataError(f"{run.name}: {error}") from error
        except Exception as error:  # what nobody foresaw is seen whole, with the run that it befell
            error.add_note(f"while training {run.name}")
            raise

    def _trained(self, run: Run, folder: Path) -> Result:
        data = self.data[run.data]
        with one_thread():
            network = fit(run.recipe, data, folder, self.quiet, bar=1)
            leaked = evaluate(network, data.held_out, leak=True) if isinstance(network, NeuralProcess) else None
            found = evaluate(network, data.held_out)
        cost = json.loads((folder / COST_FILE).read_text(encoding="utf-8"))
        return Result(run.cell, run.seed, found, leaked, cost, data.origin)


def trainer(shared: tuple[list[TrainingData], bool]) -> Trainer:
    """A process made ready for its runs."""
    return Trainer(*shared)


@contextmanager
def one_thread() -> Iterator[None]:
    """Keep torch on one thread: figures are then those of the seed, to the bit, and runs share cores evenly."""
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
    look: Callable[[list[Result]], object] = lambda _: None,
) -> list[Result]:
    """Train and measure every cell with every seed, or go on where this folder stopped; by this process unless told.

    What is ``known`` is taken as it is. After every run, ``look`` is shown all results so far.

    Seed after seed, so that a first look needs no patience; the neural process, an order dearer than all else, last.

    Raises:
        DataError: data are missing, or a folder holds runs of other data, recipes or code.
        WorkforceError: the workers cannot be started, or were lost.
    """
    executor = executor or SerialExecutor()
    runs, data = _plan(experiment, read, folder, seeds, epochs)
    results = _taken(runs, data, known or {})
    left = [run for run in runs if (run.cell, run.seed) not in results]
    with (
        executor.start(trainer, (data, quiet or not executor.serial)) as pool,
        tqdm(total=len(runs), initial=len(results), desc=experiment.name, unit="run", disable=quiet) as progress,
    ):

        def sent() -> Iterator[Run]:
            for run in left:
                progress.set_postfix_str(run.name)
                yield run if executor.shares_disk else replace(run, sent=pack(run.folder))

        for run, (result, files) in pool.as_completed(sent()):
            if files:
                unpack(files, run.folder)
            results[run.cell, run.seed] = result
            progress.update()
            look(_in_order(runs, results))
    return _in_order(runs, results)


def _in_order(runs: Sequence[Run], results: Mapping[tuple[Cell, int], Result]) -> list[Result]:
    """Those that there are, as they were planned, whoever was first."""
    return [results[run.cell, run.seed] for run in runs if (run.cell, run.seed) in results]


def _taken(
    runs: Sequence[Run], data: Sequence[TrainingData], known: Mapping[tuple[Cell, int], Result]
) -> dict[tuple[Cell, int], Result]:
    """Of what is known, what is wanted.

    Raises:
        DataError: it was made of other data.
    """
    taken = {(run.cell, run.seed): known[run.cell, run.seed] for run in runs if (run.cell, run.seed) in known}
    for run in runs:
        result = taken.get((run.cell, run.seed))
        if result is not None and result.origin != data[run.data].origin:
            raise DataError(
                f"{run.name}: the known figures are of {result.origin}, the data here {data[run.data].origin}; "
                "bring the data that they are of, or leave the known figures out"
            )
    return taken


def _plan(
    experiment: Experiment, read: DataReader, folder: Path, seeds: int, epochs: int
) -> tuple[list[Run], list[TrainingData]]:
    """Every run in its order, and the distinct data of all; what is missing is said before hours of training."""
    wanted = [(cell, seed) for seed in range(seeds) for cell in experiment.cells]
    wanted.sort(key=lambda run: METHODS[run[0].method].neural_process)
    places: dict[int, int] = {}
    data: list[TrainingData] = []
    runs = []
    for cell, seed in wanted:
        found = read(cell, seed)
        if id(found) not in places:
            places[id(found)] = len(data)
            data.append(found)
        path = folder / CELLS / cell.set_up / cell.slug / f"seed-{seed}"
        runs.append(Run(cell, seed, experiment.recipe(cell, seed, epochs), places[id(found)], path))
    return runs, data


def data_reader(experiment: Experiment, data_folder: Path, views: Path | None = None) -> DataReader:
    """What a cell with this seed is fitted to; read once for all that share it."""

    @cache
    def pushes(set_up: str, context: str) -> TrainingData:
        return read_training_data(SET_UPS[set_up](), ContextKind(context), data_folder, views)

    draw = cache(gaussian_process.draw_training_data)  # a repeat draws new processes as well as new weights

    def read(cell: Cell, seed: int) -> TrainingData:
        return draw(seed) if experiment.name == GAUSSIAN_PROCESS else pushes(cell.set_up, cell.context)

    return read
