"""Rebuild tables of the paper: run the experiments that the options name, and write their reports."""

from collections.abc import Iterator
from pathlib import Path

from service.bulk.executors import Executor
from training.paper import figures, report, reproduction
from training.paper.experiments import Experiment
from training.paper.options import ReproductionOptions


def rebuild_tables(options: ReproductionOptions, executor: Executor) -> Iterator[Path]:
    """Run each experiment with an executor, and yield the path of its report. The report is renewed after every run.

    Raises:
        DataError: Data are missing or broken, or a folder or the known figures hold runs of other data or options.
        WorkforceError: The workers cannot be started, or were lost.
    """
    for experiment in options.experiments():
        yield _rebuild(experiment, options, executor)


def _rebuild(experiment: Experiment, options: ReproductionOptions, executor: Executor) -> Path:
    epochs, seeds = options.epochs_of(experiment), options.seeds_of(experiment)
    folder = options.out / experiment.name
    read = reproduction.data_reader(experiment, options.data, options.views)
    known = {} if options.known is None else figures.read_figures(options.known, experiment, epochs)
    write = report.writer(experiment, seeds, epochs, options.command(experiment), folder)
    results = reproduction.reproduce(
        experiment, read, folder, seeds, epochs, executor=executor, known=known, on_results=write
    )
    return write(results)
