"""``cazsl-train reproduce``: rebuild tables of the paper."""

import os
from dataclasses import replace
from pathlib import Path

import click
import torch

from service.bulk.executors import choose_executor
from training.cli.errors import mend
from training.cli.options import data_option, data_words, views_option
from training.cli.runs import RUNS
from training.networks.methods import METHODS
from training.paper import figures, reproduction
from training.paper.experiments import EXPERIMENTS, GAUSSIAN_PROCESS, experiments


@click.command("reproduce")
@click.argument("names", nargs=-1, metavar="[NAME]...", type=click.Choice(EXPERIMENTS))
@click.option("--all", "everything", is_flag=True, help="Every experiment, in the paper's order.")
@click.option("--epochs", type=click.IntRange(1), help="Epochs per run. [default: the paper's]")
@click.option("--seeds", type=click.IntRange(1), help="Seeds per row. [default: 3; gaussian-process 10, as the paper]")
@click.option(
    "--cooling",
    type=click.IntRange(0),
    default=0,
    metavar="EPOCHS",
    help="Let the learning rate fall to nothing over the last EPOCHS. [default: 0, constant as the paper has it]",
)
@click.option("--skip", type=click.Choice([*METHODS]), multiple=True, help="A row to leave out; ANP costs most of all.")
@click.option(
    "--out",
    type=click.Path(file_okay=False, path_type=Path),
    default=RUNS / "reproduce",
    show_default=True,
    help="A folder with a folder per experiment.",
)
@click.option("--jobs", type=click.IntRange(1), help="Runs at once. [default: one per core; one where there is a GPU]")
@click.option("--ray", "ray_address", metavar="ADDRESS", help="Train on this Ray cluster instead: HOST:PORT, or auto.")
@click.option(
    "--known",
    type=click.Path(exists=True, dir_okay=False, path_type=Path),
    help="A figures.json of an earlier reproduction, by as many epochs of the same data: its runs are not done again.",
)
@data_option
@views_option
@mend
def reproduce(
    names: tuple[str, ...],
    everything: bool,
    epochs: int | None,
    seeds: int | None,
    cooling: int,
    skip: tuple[str, ...],
    out: Path,
    jobs: int | None,
    ray_address: str | None,
    known: Path | None,
    folder: Path,
    views: Path | None,
) -> None:
    """Rebuild tables of the paper beside the paper's own figures.

    \b
    gaussian-process     the regression of section IV-A; draws its own data
    different-objects    200 objects to train on, 50 others to test on
    different-surfaces   ABS to train on, plywood (the folder beside --data) to test on
    different-weights    objects with 0, 1 or 2 weights to test on, the others to train on

    Each writes README.md, figures.json and a plot into its folder, again after every run, and a run folder per row and
    seed. Interrupted, it goes on where it stopped when it is started again.
    To try it: --epochs 100 --seeds 1 --out runs/trial

    A run takes one core, wherever that is, and its figures are the same: --jobs says how many at once here, --ray
    ADDRESS (extra 'ray') has a cluster do them. A run whose node dies is done again on another; all that is finished
    lies in --out on this machine.
    """
    if everything == bool(names):
        raise click.UsageError(f"give one or more of {', '.join(EXPERIMENTS)}, or --all")
    if jobs is not None and ray_address is not None:
        raise click.UsageError("--jobs counts runs on this machine; give either that or --ray")
    if known is not None and len(names) != 1:
        raise click.UsageError("--known holds the runs of one experiment; give its name alone")
    executor = choose_executor(jobs or _cores(), ray_address)
    from training.paper import report  # matplotlib is slow to load, and no other command of training needs it

    for name in EXPERIMENTS if everything else names:
        experiment = replace(experiments()[name].without(skip), cooling_epochs=cooling)
        rounds, runs = epochs or experiment.epochs, seeds or experiment.seeds
        if cooling > rounds:
            raise click.UsageError(f"--cooling: received {cooling}; accepted is up to {rounds}, the epochs of {name}")
        read = reproduction.data_reader(experiment, folder, views)
        earlier = {} if known is None else figures.read_figures(known, experiment, rounds)
        command = f"cazsl-train reproduce {name} --epochs {rounds} --seeds {runs} --out {out}"
        command += f" --cooling {cooling}" if cooling else ""
        command += "".join(f" --skip '{method}'" for method in skip)
        command += "" if known is None else f" --known {known}"
        command += "" if name == GAUSSIAN_PROCESS else data_words(folder, views)
        write = report.writer(experiment, runs, rounds, command, out / name)
        path = write(
            reproduction.reproduce(
                experiment, read, out / name, runs, rounds, executor=executor, known=earlier, look=write
            )
        )
        click.echo(f"next: read {path}; its plot is {path.parent / report.PLOT_FILE}")


def _cores() -> int:
    """How many runs fit this machine: one on each core, or one on its GPU."""
    if torch.cuda.is_available():
        return 1
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
