"""``cazsl-train reproduce``: rebuild tables of the paper."""

from pathlib import Path
from typing import Any

import click
import torch

from service.bulk.executors import choose_executor
from service.cli.command_line import FILE_THAT_EXISTS, FOLDER, argument, option
from service.cli.terminal import echo
from service.processors import processors
from training.cli.options import data_option, views_option
from training.cli.runs import RUNS
from training.networks.methods import METHODS
from training.paper.experiments import EXPERIMENTS
from training.paper.options import ReproductionOptions


@click.command("reproduce")
@argument("names", nargs=-1, metavar="[NAME]...", type=click.Choice(EXPERIMENTS))
@option("--all", "everything", is_flag=True, help="Every experiment, in the paper's order.")
@option("--epochs", type=click.IntRange(1), help="Epochs per run. [default: the paper's]")
@option("--seeds", type=click.IntRange(1), help="Seeds per row. [default: 3; gaussian-process 10, as the paper]")
@option(
    "--cooling",
    type=click.IntRange(0),
    default=0,
    metavar="EPOCHS",
    help="Lower the learning rate to zero over the last EPOCHS. [default: 0, a constant rate as in the paper]",
)
@option("--skip", type=click.Choice([*METHODS]), multiple=True, help="Row to leave out. ANP is the slowest one.")
@option(
    "--out",
    type=FOLDER,
    default=RUNS / "reproduce",
    show_default=True,
    help="Output folder, with a folder per experiment.",
)
@option(
    "--jobs", type=click.IntRange(1), help="Runs at once on this machine. [default: one per processor; one on a GPU]"
)
@option("--ray", "ray_address", metavar="ADDRESS", help="Train on this Ray cluster instead: HOST:PORT, or auto.")
@option(
    "--known",
    type=FILE_THAT_EXISTS,
    help="figures.json of an earlier reproduction of the same data, epochs and code. Its runs are not repeated.",
)
@data_option
@views_option
def reproduce(folder: Path, **options: Any) -> None:
    """Rebuild tables of the paper beside the paper's own figures.

    \b
    gaussian-process     the regression of section IV-A, with data of its own
    different-objects    200 objects to train on, 50 others to test on
    different-surfaces   ABS to train on, plywood (the folder beside --data) to test on
    different-weights    objects with 0, 1 or 2 weights to test on, the others to train on

    Each experiment writes README.md, figures.json and a plot into its folder, again after every run, and a run folder
    per row and seed. An interrupted reproduction continues when it is started again.
    To try it: --epochs 100 --seeds 1 --out runs/trial

    A run takes one core and has the same figures wherever it runs. --jobs sets the number of runs at once on this
    machine. --ray ADDRESS (extra 'ray') runs them on a cluster. A run whose node dies is repeated on another node. All
    results are written to --out on this machine.
    """
    try:
        wanted = ReproductionOptions(data=folder, **options)
    except ValueError as error:
        raise click.UsageError(str(error)) from error
    executor = choose_executor(wanted.jobs or default_jobs(), wanted.ray_address)
    from training.paper import rebuild, report  # slow to import, as matplotlib is

    for path in rebuild.rebuild_tables(wanted, executor):
        echo(f"next: read {path}; its plot is {path.parent / report.PLOT_FILE}")


def default_jobs() -> int:
    """Return the number of runs at once that fit this machine: one per processor, or one on a GPU."""
    return 1 if torch.cuda.is_available() else processors()
