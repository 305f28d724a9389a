"""Run an experiment of the paper: every cell and seed is a run folder, and what is finished is not done again."""

import json
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Final

from tqdm import tqdm

from service.contract import ContextKind
from training import gaussian_process
from training.evaluate import Evaluation, evaluate
from training.experiments import GAUSSIAN_PROCESS, Cell, Experiment
from training.fit import COST_FILE, fit
from training.methods import METHODS
from training.neural_process import NeuralProcess
from training.recipes import SET_UPS
from training.samples import TrainingData, read_training_data

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


def reproduce(
    experiment: Experiment, read: DataReader, folder: Path, seeds: int, epochs: int, quiet: bool = False
) -> list[Result]:
    """Train and measure every cell with every seed, or go on where this folder stopped.

    Seed after seed, so that a first look needs no patience; the neural process, an order dearer than all else, last.

    Raises:
        DataError: data are missing, or a folder holds runs of other data, recipes or code.
    """
    runs = [(cell, seed) for seed in range(seeds) for cell in experiment.cells]
    runs.sort(key=lambda run: METHODS[run[0].method].neural_process)
    for cell, _ in runs:
        read(cell, 0)  # what is missing is said before hours of training
    results = []
    with tqdm(runs, desc=experiment.name, unit="run", disable=quiet) as progress:
        for cell, seed in progress:
            progress.set_postfix_str(f"{cell.set_up}, {cell.slug}, seed {seed}")
            results.append(_run(experiment, cell, seed, epochs, read(cell, seed), folder, quiet))
    return results


def data_reader(experiment: Experiment, data_folder: Path, views: Path | None = None) -> DataReader:
    """What a cell with this seed is fitted to; read once for all that share it."""

    @cache
    def pushes(set_up: str, context: str) -> TrainingData:
        return read_training_data(SET_UPS[set_up](), ContextKind(context), data_folder, views)

    draw = cache(gaussian_process.draw_training_data)  # a repeat draws new processes as well as new weights

    def read(cell: Cell, seed: int) -> TrainingData:
        return draw(seed) if experiment.name == GAUSSIAN_PROCESS else pushes(cell.set_up, cell.context)

    return read


def _run(
    experiment: Experiment, cell: Cell, seed: int, epochs: int, data: TrainingData, folder: Path, quiet: bool
) -> Result:
    run = folder / CELLS / cell.set_up / cell.slug / f"seed-{seed}"
    network = fit(experiment.recipe(cell, seed, epochs), data, run, quiet, bar=1)
    leaked = evaluate(network, data.held_out, leak=True) if isinstance(network, NeuralProcess) else None
    cost = json.loads((run / COST_FILE).read_text(encoding="utf-8"))
    return Result(cell, seed, evaluate(network, data.held_out), leaked, cost, data.origin)
