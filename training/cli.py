"""``cazsl-train``: simulate pushes, fit a recipe, evaluate it, publish it."""

import functools
import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Final, ParamSpec

import click
import torch

import service
from service.errors import CazslError
from service.manifest import DEFAULT_ALIAS, is_alias
from service.registry import Registry
from training import export, fit, images, recipes, simulate
from training.data import omnipush_descriptors, read_folder
from training.evaluate import Evaluation, NormalisedPushes
from training.evaluate import evaluate as evaluate_network

DEFAULT_DATA: Final = Path("data/simulated/abs")
DEFAULT_VIEWS: Final = Path("data/simulated/top-down_view")
DEFAULT_CAMERA_VIEWS: Final = Path("data/simulated/top-down_view-camera")
RUNS: Final = Path("runs")
P = ParamSpec("P")


@click.group(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
@click.version_option(service.__version__, prog_name="cazsl-train")
def main() -> None:
    """Train pushing models and publish them.

    \b
    cazsl-train simulate                        62,500 pushes of 250 objects into data/simulated/abs
    cazsl-train images                          their top-down views into data/simulated/top-down_view
    cazsl-train fit push-indicator              the paper's FCN + CM + L2Reg into runs/push-indicator
    cazsl-train evaluate runs/push-indicator    its figures on held-out objects
    cazsl-train publish runs/push-indicator     the next version of models/push-indicator

    Every step that was interrupted goes on where it stopped when it is started again.
    """


def mend(command: Callable[P, None]) -> Callable[P, None]:
    """An error of ours becomes one line and exit status 1."""

    @functools.wraps(command)
    def run(*args: P.args, **kwargs: P.kwargs) -> None:
        try:
            command(*args, **kwargs)
        except CazslError as error:
            raise click.ClickException(str(error)) from error

    return run


data_option = click.option(
    "--data",
    "folder",
    type=click.Path(file_okay=False, path_type=Path),
    default=DEFAULT_DATA,
    show_default=True,
    help="A folder of Omnipush-format files.",
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


@main.command("simulate")
@data_option
@click.option("--pushes", type=click.IntRange(1, 100_000), default=250, show_default=True, help="Pushes per object.")
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="Of all that is random.")
@click.option("--threads", type=click.IntRange(1, 1024), help="Threads; the files are the same. [default: all cores]")
@mend
def simulate_pushes(folder: Path, pushes: int, seed: int, threads: int | None) -> None:
    """Simulate the default dataset: all 250 objects of Omnipush, pushed in MuJoCo, in Omnipush's file format."""
    plan = simulate.SimulationPlan(omnipush_descriptors(), pushes, seed)
    simulate.simulate_dataset(plan, folder, threads)
    found = read_folder(folder)
    click.echo(f"{folder}: {found.source}: {len(found.descriptors)} objects, {found.count} pushes, ", nl=False)
    click.echo(f"{100 * simulate.missed_share(found.outcomes):.2f} % missed the object; sha256 {found.digest}")
    click.echo(f"{'':18}{'mean':>10}{'published':>11}{'std':>10}{'published':>11}{'ratio':>7}")
    for quantity, mean, mean_0, std, std_0 in simulate.likeness(found):
        click.echo(f"{quantity:18}{mean:10.5f}{mean_0:11.5f}{std:10.5f}{std_0:11.5f}{std / std_0:7.3f}")
    click.echo("next: cazsl-train fit push-indicator")


@main.command("images")
@click.argument("folder", type=click.Path(file_okay=False, path_type=Path), required=False)
@click.option("--camera", is_flag=True, help="As a camera would see them: light, table, blur, noise, JPEG.")
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="Of all that --camera adds.")
@click.option(
    "--gallery",
    type=click.Path(dir_okay=False, path_type=Path),
    help="Only draw this PNG: some objects as drawn, as a camera sees them, and as a model does.",
)
@mend
def draw_images(folder: Path | None, camera: bool, seed: int, gallery: Path | None) -> None:
    """Draw the top-down views of all 250 objects into FOLDER, in Omnipush's file format.

    FOLDER is data/simulated/top-down_view, with --camera data/simulated/top-down_view-camera, unless named. Views that
    are already there stay; the files depend on object and seed alone.
    """
    if gallery is not None:
        from training.image_gallery import draw_gallery  # matplotlib is slow to load, and no other command needs it

        draw_gallery(gallery, seed=seed)
        click.echo(f"{gallery} shows clean views, camera views, and the 32 x 32 that a model sees")
        return
    folder = folder or (DEFAULT_CAMERA_VIEWS if camera else DEFAULT_VIEWS)
    descriptors = omnipush_descriptors()
    images.write_views(folder, descriptors, camera, seed)
    seen = images.read_views(folder, descriptors)
    digest = hashlib.sha256(seen.tobytes()).hexdigest()
    click.echo(f"{folder}: {len(seen)} views of 481 x 481; sha256 of the 32 x 32 that models see: {digest}")
    click.echo("next: cazsl-train images --gallery views.png, and look at it")


@main.command("fit")
@click.argument("recipe")
@data_option
@click.option("--run", type=click.Path(file_okay=False, path_type=Path), help="The run folder. [default: runs/RECIPE]")
@mend
def fit_recipe(recipe: str, folder: Path, run: Path | None) -> None:
    """Train a RECIPE: the name of one that ships (push-indicator, push-none) or a .toml file."""
    run = run or RUNS / Path(recipe).stem
    fit.fit(recipes.read_recipe(recipe), read_folder(folder), run)
    click.echo(f"weights and metrics are in {run}; next: cazsl-train evaluate {run}{_data_words(folder)}")


@main.command("evaluate")
@run_argument
@data_option
@mend
def evaluate(run: Path, folder: Path) -> None:
    """Print RMSE, STD, Dist., NLL and coverage of a finished RUN on its held-out objects."""
    recipe, network, _ = fit.load_run(run)
    split, pushes = recipe.split(), read_folder(folder)
    found = evaluate_network(network, NormalisedPushes.of(pushes.select(split.test), torch.device("cpu")))
    click.echo(
        f"{recipe.method}, {recipe.epochs} epochs, {split.name}: {len(split.test)} held-out objects of {pushes.source}"
    )
    click.echo(_figures(found))
    click.echo(f"next: cazsl-train publish {run}{_data_words(folder)}")


@main.command("publish")
@run_argument
@data_option
@registry_option
@click.option("--alias", default=DEFAULT_ALIAS, show_default=True, help="Point this alias at the new version.")
@click.option("--no-alias", is_flag=True, help="Publish only; whoever asks for the alias gets what they got before.")
@mend
def publish(run: Path, folder: Path, registry: Path, alias: str, no_alias: bool) -> None:
    """Publish a finished RUN as the next version of its model; a running service picks it up by itself."""
    recipe, network, trained_on = fit.load_run(run)
    pushes = read_folder(folder)
    if not is_alias(alias):
        raise click.ClickException("an alias is of lower-case letters, digits, '-' and '_', and not a number")
    if pushes.digest != trained_on["sha256"]:
        raise click.ClickException(f"{folder} is not the data that {run} was trained on; name that with --data")
    store = Registry(registry)
    manifest = export.publish(recipe, network, pushes, store)
    click.echo(f"published {manifest.name}@{manifest.version} in {registry}")
    if not no_alias:
        store.point_alias(manifest.name, alias, manifest.version)
        click.echo(f"{manifest.name}@{alias} is version {manifest.version} now")
    click.echo(f"next: cazsl models show {manifest.name}@{manifest.version}")


def _data_words(folder: Path) -> str:
    """The option that the next command needs as well."""
    return "" if folder == DEFAULT_DATA else f" --data {folder}"


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
