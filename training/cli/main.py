"""``cazsl-train``: simulate pushes, draw views, fit a recipe, evaluate it, publish it, reproduce the paper."""

import os
from dataclasses import replace
from pathlib import Path
from typing import Final

import click
import torch

import service
from service.bulk.executors import gather
from service.model.manifest import DEFAULT_ALIAS, is_alias
from service.registry.registry import NOWHERE, Registry
from training.cli.data import data
from training.cli.errors import mend
from training.cli.simulation import DEFAULT_DATA, draw_images, simulate_pushes
from training.fitting import recipe as recipes
from training.fitting import training_loop as fit
from training.fitting.evaluation import Evaluation
from training.fitting.evaluation import evaluate as evaluate_network
from training.fitting.samples import read_pushes, read_training_data, views_beside
from training.networks.methods import METHODS
from training.paper import figures, reproduction
from training.paper.experiments import EXPERIMENTS, GAUSSIAN_PROCESS, experiments
from training.publishing import publish as export
from training.simulation import drawing as images

RUNS: Final = Path("runs")


@click.group(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
@click.version_option(service.__version__, prog_name="cazsl-train")
def main() -> None:
    """Train pushing models and publish them.

    \b
    cazsl-train simulate                        62,500 pushes of 250 objects on ABS, 2,500 of 10 on plywood
    cazsl-train data check FOLDER               is this copy of Omnipush fit to train on?
    cazsl-train images --camera                 their top-down views as a camera would see them
    cazsl-train fit push-indicator              the served model into runs/push-indicator; the paper's: fit paper
    cazsl-train evaluate runs/push-indicator    its figures on held-out objects
    cazsl-train publish runs/push-indicator     the next version of models/push-indicator
    cazsl-train reproduce --all                 every table of the paper, beside the paper's own figures

    Every step that was interrupted goes on where it stopped when it is started again.
    """


data_option = click.option(
    "--data",
    "folder",
    type=click.Path(file_okay=False, path_type=Path),
    default=DEFAULT_DATA,
    show_default=True,
    help="A folder of Omnipush-format files.",
)
views_option = click.option(
    "--views",
    type=click.Path(file_okay=False, path_type=Path),
    help="A folder of top-down views, for visual contexts. [default: top-down_view beside the data]",
)
registry_option = click.option(
    "--registry",
    type=click.Path(file_okay=False, path_type=Path),
    envvar="CAZSL_REGISTRY",
    default=Path("models"),
    show_default=True,
    help="The folder of models.",
)
run_argument = click.argument("run", type=click.Path(file_okay=False, path_type=Path))


main.add_command(simulate_pushes)
main.add_command(draw_images)
main.add_command(data)


@main.command("fit")
@click.argument("recipe")
@data_option
@views_option
@click.option("--run", type=click.Path(file_okay=False, path_type=Path), help="The run folder. [default: runs/RECIPE]")
@click.option("--set-up", type=click.Choice([*recipes.SET_UPS]), help="Train the recipe on this set-up instead.")
@mend
def fit_recipe(recipe: str, folder: Path, views: Path | None, run: Path | None, set_up: str | None) -> None:
    """Train a RECIPE: the name of one that ships (push-indicator, push-visual, push-none, paper) or a .toml file.

    \b
    To serve what learnt from all objects, with the figures of a run of RECIPE that held some out:
    cazsl-train fit RECIPE --set-up all-objects
    cazsl-train publish runs/RECIPE-all-objects --measured runs/RECIPE
    """
    run = run or RUNS / "-".join(filter(None, (Path(recipe).stem, set_up)))
    wanted = recipes.read_recipe(recipe)
    wanted = wanted if set_up is None else replace(wanted, set_up=set_up)
    fit.fit(wanted, read_training_data(wanted.split(), wanted.context_kind, folder, views), run)
    following = f"evaluate {run}" if wanted.split().test else f"publish {run} --measured RUN"
    click.echo(f"weights and metrics are in {run}; next: cazsl-train {following}{_data_words(folder, views)}")


@main.command("evaluate")
@run_argument
@data_option
@views_option
@mend
def evaluate(run: Path, folder: Path, views: Path | None) -> None:
    """Print RMSE, STD, Dist., NLL and coverage of a finished RUN on its held-out objects."""
    recipe, network, _ = fit.load_run(run)
    split = recipe.split()
    if not split.test:
        raise click.ClickException(f"{run} was trained on every object; evaluate its recipe on different-objects")
    data = read_training_data(split, recipe.context_kind, folder, views)
    found = evaluate_network(network, data.held_out)
    source = data.origin.get("held_out_source", data.origin["source"])
    click.echo(f"{recipe.method}, {recipe.epochs} epochs, {split.name}: {len(split.test)} held-out objects of {source}")
    click.echo(_figures(found))
    click.echo(f"next: cazsl-train publish {run}{_data_words(folder, views)}")


@main.command("publish")
@run_argument
@data_option
@views_option
@registry_option
@click.option(
    "--alias", default=DEFAULT_ALIAS, show_default=True, help="Point this alias here if it names nothing yet."
)
@click.option("--no-alias", is_flag=True, help="Publish only, even as the first version.")
@click.option(
    "--measured",
    type=click.Path(file_okay=False, path_type=Path),
    help="Of a RUN on all objects: a run of the same recipe that held some out, whose figures these are.",
)
@mend
def publish(
    run: Path, folder: Path, views: Path | None, registry: Path, alias: str, no_alias: bool, measured: Path | None
) -> None:
    """Publish a finished RUN as the next version of its model; a running service picks it up by itself.

    A first version becomes the champion. Later ones are served by their number, and an alias that already serves is
    moved by cazsl models promote, which compares the two first.
    """
    recipe, network, trained_on = fit.load_run(run)
    pushes = read_pushes(folder, recipe.context_kind, views)
    if not is_alias(alias):
        raise click.ClickException("an alias is of lower-case letters, digits, '-' and '_', and not a number")
    judged = None if measured is None else fit.load_run(measured)
    for path, origin in ((run, trained_on), *([] if judged is None else [(measured, judged[2])])):
        if pushes.digest != origin["sha256"]:
            raise click.ClickException(
                f"{folder} is not the data that {path} was trained on; name that with --data, other views with --views"
            )
    store = Registry(registry)
    convention = None if pushes.views is None else images.convention_of(views or views_beside(folder))
    manifest = export.publish(recipe, network, pushes, store, convention, None if judged is None else judged[:2])
    click.echo(f"published {manifest.name}@{manifest.version} in {registry}")
    if no_alias or alias in store.aliases(manifest.name):
        click.echo(f"next: cazsl models promote {manifest.name} {manifest.version} --alias {alias}")
        return
    store.point_alias(manifest.name, alias, manifest.version, expect=NOWHERE)
    click.echo(f"{manifest.name}@{alias} is version {manifest.version} now")
    click.echo(f"next: cazsl models show {manifest.name}@{manifest.version}")


@main.command("reproduce")
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
    workforce = gather(jobs or _cores(), ray_address)
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
        command += "" if name == GAUSSIAN_PROCESS else _data_words(folder, views)
        write = report.writer(experiment, runs, rounds, command, out / name)
        path = write(
            reproduction.reproduce(
                experiment, read, out / name, runs, rounds, workforce=workforce, known=earlier, look=write
            )
        )
        click.echo(f"next: read {path}; its plot is {path.parent / report.PLOT_FILE}")


def _cores() -> int:
    """How many runs fit this machine: one on each core, or one on its GPU."""
    if torch.cuda.is_available():
        return 1
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _data_words(folder: Path, views: Path | None) -> str:
    """The options that the next command needs as well."""
    return ("" if folder == DEFAULT_DATA else f" --data {folder}") + ("" if views is None else f" --views {views}")


def _figures(found: Evaluation) -> str:
    """A line of names above a line of numbers."""
    columns = {
        "RMSE": f"{found.rmse:.4f}",
        "STD": f"{found.std:.4f}",
        "Dist. (mm)": f"{found.distance_mm:.2f}",
        "NLL": f"{found.nll:.3f}",
        **{f"{100 * level:.0f} % cov.": f"{100 * share:.1f} %" for level, share in found.coverage.items()},
    }
    widths = {name: max(len(name), len(value)) + 2 for name, value in columns.items()}
    return "\n".join(
        "".join(text.rjust(widths[name]) for name, text in row)
        for row in (zip(columns, columns, strict=True), columns.items())
    )
