"""``cazsl-train fit``, ``evaluate`` and ``publish``."""

from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import click

from service.cli.command_line import FILE, FOLDER, argument, option
from service.cli.terminal import echo, echo_lines
from service.model.manifest import Manifest
from service.model.reference import DEFAULT_ALIAS, is_alias
from service.model.tensors import ContextKind
from service.registry.registry import NOWHERE, Registry
from training.cli import shape_runs
from training.cli.options import registry_option, run_argument, run_data_option, views_option
from training.fitting.bands import bands, calibrated
from training.fitting.evaluation import COVERAGE_LEVELS, Evaluation, Predictions
from training.fitting.evaluation import evaluate as evaluate_network
from training.fitting.recipe import SET_UPS, SHAPE_SET_UPS, Recipe, read_recipe
from training.fitting.run_folder import Network, load_run
from training.fitting.samples import read_pushes, read_training_data
from training.fitting.support_evaluation import SupportFigures, evaluate_supports
from training.fitting.training_loop import fit
from training.networks.neural_process import NeuralProcess
from training.networks.push_network import PushNetwork
from training.omnipush.layout import DEFAULT_DATA, data_options
from training.omnipush.views import convention_of, views_beside
from training.publishing.publish import publish as publish_network
from training.publishing.support_publish import publish_supports

RUNS: Final = Path("runs")


@click.command("fit")
@argument("recipe")
@run_data_option
@views_option
@option("--run", type=FOLDER, help="Run folder. [default: runs/RECIPE]")
@option("--set-up", type=click.Choice([*SET_UPS, *SHAPE_SET_UPS]), help="Set-up to train on instead of the recipe's.")
def fit_recipe(recipe: str, folder: Path | None, views: Path | None, run: Path | None, set_up: str | None) -> None:
    """Train a RECIPE: push-indicator, push-visual, push-none, push-shape, push-anp, paper, or a .toml file.

    \b
    To serve a model of all objects, with the figures of a run of RECIPE that held some out:
    cazsl-train fit RECIPE --set-up all-objects
    cazsl-train publish runs/RECIPE-all-objects --measured runs/RECIPE

    \b
    push-shape is trained on a table of shapes, and its set-ups are different-families and all-families:
    cazsl-train simulate shapes
    cazsl-train fit push-shape
    """
    run = run or RUNS / "-".join(filter(None, (Path(recipe).stem, set_up)))
    wanted = read_recipe(recipe)
    wanted = wanted if set_up is None else replace(wanted, set_up=set_up)
    if wanted.context_kind is ContextKind.SHAPE:
        shape_runs.fit_shapes(wanted, folder or shape_runs.DEFAULT_SHAPES, run)
        return
    folder = folder or DEFAULT_DATA
    fit(wanted, read_training_data(wanted.split(), wanted.context_kind, folder, views, wanted.camera_views), run)
    following = f"evaluate {run}" if wanted.split().test else f"publish {run} --measured RUN"
    echo(f"weights and metrics are in {run}; next: cazsl-train {following}{data_options(folder, views)}")


@click.command("evaluate")
@run_argument
@run_data_option
@views_option
def evaluate(run: Path, folder: Path | None, views: Path | None) -> None:
    """Print RMSE, STD, Dist., NLL and coverage of a finished RUN on its held-out objects.

    Deviations are calibrated, as they would be published, and coverage is shown by ring of starts and band of aims.
    """
    recipe, network, _ = load_run(run)
    if recipe.context_kind is ContextKind.SHAPE:
        shape_runs.evaluate_run(run, recipe, network, folder or shape_runs.DEFAULT_SHAPES)
        return
    folder = folder or DEFAULT_DATA
    split = recipe.split()
    if not split.test:
        raise click.ClickException(f"{run} was trained on every object; evaluate its recipe on different-objects")
    data = read_training_data(split, recipe.context_kind, folder, views, recipe.camera_views)
    source = data.origin.get("held_out_source", data.origin["source"])
    echo(f"{recipe.method}, {recipe.epochs} epochs, {split.name}: {len(split.test)} held-out objects of {source}")
    echo_lines(_figures(evaluate_network(network, data.held_out)))
    if isinstance(network, NeuralProcess) and recipe.context_kind is ContextKind.SUPPORT:
        echo_lines(_by_support(evaluate_supports(network, data.held_out)))
    if isinstance(network, PushNetwork):
        found = calibrated(network, data.held_out)
        echo(f"with every deviation times {found.factor:.3f}, a factor from held-out objects:")
        for kind, predictions in found.predictions.items():
            echo_lines(_bands(kind, predictions))
    echo(f"next: cazsl-train publish {run}{data_options(folder, views)}")


@click.command("publish")
@run_argument
@run_data_option
@views_option
@registry_option
@option(
    "--alias", default=DEFAULT_ALIAS, show_default=True, help="Alias to point to the version if it does not exist yet."
)
@option("--no-alias", is_flag=True, help="Set no alias, even for the first version.")
@option("--scores", type=FILE, help="Text for the card of push-shape on other data, such as recorded pushes.")
@option(
    "--measured",
    type=FOLDER,
    help="For a RUN on all objects: the run of the same recipe that held some out and gives the figures.",
)
def publish(
    run: Path,
    folder: Path | None,
    views: Path | None,
    registry: Path,
    alias: str,
    no_alias: bool,
    scores: Path | None,
    measured: Path | None,
) -> None:
    """Publish a finished RUN as the next version of its model. A running service loads it by itself.

    The first version becomes the champion. Later versions are served by their number. To move an alias that exists,
    use cazsl models promote, which compares the two versions first.
    """
    recipe, network, trained_on = load_run(run)
    if not is_alias(alias):
        raise click.ClickException(
            f"--alias: {alias} is not an alias; use lower-case letters, digits, '-' and '_', and not a number"
        )
    judged = None if measured is None else load_run(measured)
    store = Registry(registry)
    if recipe.context_kind is ContextKind.SHAPE:
        folder = folder or shape_runs.DEFAULT_SHAPES
        manifest = shape_runs.publish_run((recipe, network, trained_on), folder, store, judged, scores)
    else:
        manifest = _publish_omnipush((run, recipe, network, trained_on), folder or DEFAULT_DATA, views, store, measured)
    echo(f"published {manifest.name}@{manifest.version} in {registry}")
    if no_alias or alias in store.aliases(manifest.name):
        echo(f"next: cazsl models promote {manifest.name} {manifest.version} --alias {alias}")
        return
    store.point_alias(manifest.name, alias, manifest.version, expect=NOWHERE)
    echo(f"{manifest.name}@{alias} is version {manifest.version} now")
    echo(f"next: cazsl models show {manifest.name}@{manifest.version}")


def _publish_omnipush(
    found: tuple[Path, Recipe, Network, dict[str, Any]],
    folder: Path,
    views: Path | None,
    store: Registry,
    measured: Path | None,
) -> Manifest:
    """Publish a run on Omnipush's objects."""
    run, recipe, network, trained_on = found
    judged = None if measured is None else load_run(measured)
    pushes = read_pushes(folder, recipe.context_kind, views, recipe.camera_views)
    for path, origin in ((run, trained_on), *([] if judged is None else [(measured, judged[2])])):
        if pushes.digest != origin["sha256"]:
            raise click.ClickException(
                f"{folder} is not the data that {path} was trained on; name its data with --data, other views with "
                "--views"
            )
    convention = None if pushes.views is None else convention_of(views or views_beside(folder))
    if isinstance(network, NeuralProcess) and recipe.context_kind is ContextKind.SUPPORT:
        others = None if judged is None else (judged[0], _process(judged[1]))
        return publish_supports(recipe, network, pushes, store, others)
    return publish_network(recipe, network, pushes, store, convention, None if judged is None else judged[:2])


def _process(network: Network) -> NeuralProcess:
    if not isinstance(network, NeuralProcess):
        raise click.ClickException("the run that was measured is of another method; fit push-anp")
    return network


def _by_support(found: SupportFigures) -> str:
    """Return a table by the number of pushes in a support, calibrated."""
    lines = ["pushes in the support     RMSE      NLL   90 % cov.   std times"]
    for count, each in sorted(found.predictions.items()):
        figures = each.measures()
        shares = f"{100 * figures.coverage[0.9]:10.1f} %{found.factors[count]:12.3f}"
        lines.append(f"{count:21d}{figures.rmse:9.4f}{figures.nll:9.3f}{shares}")
    return "\n".join(lines)


def _bands(kind: str, found: Predictions) -> str:
    """Return a table of coverage by band, under the figures of all pushes."""
    figures = [(kind or "all pushes", len(found.mean), found.measures())]
    figures += [(band.name(), band.pushes, band.found) for band in bands(found)]
    levels = "".join(f"{100 * level:.0f} % cov.".rjust(13) for level in COVERAGE_LEVELS)
    lines = [" " * 24 + "pushes".rjust(8) + "RMSE".rjust(9) + levels]
    for name, pushes, each in figures:
        shares = "".join(f"{100 * share:.1f} %".rjust(13) for share in each.coverage.values())
        lines.append(f"{name:24s}{pushes:8d}{each.rmse:9.4f}{shares}")
    return "\n".join(lines)


def _figures(found: Evaluation) -> str:
    """Return a line of names above a line of numbers."""
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
