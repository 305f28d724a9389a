"""Runs on tables of shapes: the part of ``cazsl-train fit``, ``evaluate`` and ``publish`` for push-shape."""

from pathlib import Path
from typing import Any

import click

from service.cli.terminal import echo, echo_lines
from service.errors import DataError
from service.files import read_text
from service.model.manifest import Manifest
from service.registry.registry import Registry
from training.cli.shapes import DEFAULT_FOLDER as DEFAULT_SHAPES
from training.fitting.recipe import ALL_FAMILIES, DIFFERENT_FAMILIES, Recipe
from training.fitting.run_folder import Network
from training.fitting.shape_evaluation import evaluate_shapes
from training.fitting.shape_samples import read_shapes, shape_training_data
from training.fitting.training_loop import fit
from training.networks.push_network import PushNetwork
from training.networks.shape_network import SMALL_M
from training.publishing.shape_publish import publish_shapes
from training.tables.push_table import PushTable

__all__ = ["DEFAULT_SHAPES", "evaluate_run", "fit_shapes", "publish_run"]
Run = tuple[Recipe, Network, dict[str, Any]]


def fit_shapes(recipe: Recipe, folder: Path, run: Path) -> None:
    """Train a recipe on a table of shapes."""
    table, split = read_shapes(folder, recipe.set_up)
    fit(recipe, shape_training_data(table, split, recipe.seed), run)
    options = _data_options(folder)
    following = f"evaluate {run}" if recipe.set_up == DIFFERENT_FAMILIES else f"publish {run} --measured RUN"
    echo(f"weights and metrics are in {run}; next: cazsl-train {following}{options}")


def evaluate_run(run: Path, recipe: Recipe, network: Network, folder: Path) -> None:
    """Print error, likelihood and coverage of a run on held-out objects and on families never seen."""
    table, split = read_shapes(folder, recipe.set_up)
    found = evaluate_shapes(_push_network(network), split, recipe.seed)
    echo(f"{recipe.method}, {recipe.epochs} epochs, {recipe.set_up}: held-out objects of {table.source}")
    lines = [" " * 20 + "pushes     RMSE      NLL  90 % intervals  50, 90, 95 % regions"]
    for name, each in found.predictions.items():
        figures = each.measures()
        regions = "".join(f"{100 * share:7.1f}" for share in each.regions())
        lines.append(
            f"{name:18s}{len(each.mean):8d}{figures.rmse:9.4f}{figures.nll:9.3f}"
            f"{100 * figures.coverage[0.9]:15.1f} %{regions} %"
        )
    echo_lines("\n".join(lines))
    echo(
        f"every deviation is times {found.factor.scale:.3f}, the conformal factor of held-out objects, and of objects "
        f"smaller than {SMALL_M:g} m also times their ratio to the power {found.factor.small:.3f}"
    )
    unmeasured = f"fit {recipe.name} --set-up {ALL_FAMILIES}{_data_options(folder)}, then publish it --measured {run}"
    echo(f"next: cazsl-train {unmeasured}")


def publish_run(run: Run, folder: Path, store: Registry, judged: Run | None, scores: Path | None) -> Manifest:
    """Publish a run on a table of shapes.

    Raises:
        DataError: the table is not that of the runs, or a file cannot be read.
    """
    recipe, network, _ = run
    table, _ = read_shapes(folder, recipe.set_up)
    _check_data(table, folder, [run, *([] if judged is None else [judged])])
    try:
        text = "" if scores is None else f"\n{read_text(scores).strip()}\n"
    except OSError as error:
        raise DataError(f"{scores} cannot be read: {error.strerror}") from error
    measured = None if judged is None else (judged[0], _push_network(judged[1]))
    return publish_shapes(recipe, _push_network(network), table, store, measured, text)


def _check_data(table: PushTable, folder: Path, runs: list[Run]) -> None:
    if any(table.digest != origin["sha256"] for _, _, origin in runs):
        raise click.ClickException(f"{folder} is not the table that the run was trained on; name it with --data")


def _push_network(network: Network) -> PushNetwork:
    if not isinstance(network, PushNetwork):
        raise click.ClickException("the method of the run is not served; fit push-shape")
    return network


def _data_options(folder: Path) -> str:
    return "" if folder == DEFAULT_SHAPES else f" --data {folder}"
