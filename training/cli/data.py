"""``cazsl-train data``: look at folders of pushes, and write them again in the release's variants."""

import json
from pathlib import Path
from typing import Final

import click

from training.cli.errors import mend
from training.inspection.inspection import inspect
from training.inspection.text import inspection_document, inspection_lines
from training.omnipush.files import Variant
from training.omnipush.pushes import export_variants

VARIANTS: Final = {"raw": (Variant.RAW,), "normalised": (Variant.NORMALISED,), "both": tuple(Variant)}
folder_argument = click.argument("folder", type=click.Path(path_type=Path))


@click.group("data")
def data() -> None:
    """Look at folders of pushes, and write them again as Omnipush was published.

    \b
    cazsl-train data check data/omnipush           what a copy of Omnipush holds, and what is wrong with it
    cazsl-train data export data/simulated/abs OUT the same pushes, raw and normalised
    """


@data.command("check", short_help="Is this folder whole, like Omnipush, and fit to train on?")
@folder_argument
@click.option("--json", "as_json", is_flag=True, help="Print one JSON document instead of the table.")
@mend
def check(folder: Path, as_json: bool) -> None:
    """Read a copy of Omnipush, or anything in its format, and tell what it holds and what is odd.

    FOLDER is one surface's folder, or one above several (abs or 0,1,2_weights, plywood, top-down_view). Every file is
    read; objects are matched to the published lists up to rotation by whole sides. Exit status 1 means that training
    on it would be wrong: the errors say why. Warnings are for you to judge.
    """
    inspection = inspect(folder)
    if as_json:
        click.echo(json.dumps(inspection_document(inspection), indent=2))
    else:
        click.echo("\n".join(inspection_lines(inspection)))
    if not inspection.fit_to_train_on:
        click.get_current_context().exit(1)


@data.command("export", short_help="Write a folder again, raw, normalised or both.")
@folder_argument
@click.argument("target", type=click.Path(path_type=Path))
@click.option(
    "--variant",
    type=click.Choice(list(VARIANTS)),
    default="both",
    show_default=True,
    help="raw: metres and radians; normalised: less the published mean, divided by the published deviation.",
)
@mend
def export(folder: Path, target: Path, variant: str) -> None:
    """Write one surface's pushes of FOLDER into TARGET as Omnipush was published; its label goes with them."""
    count = export_variants(folder, target, VARIANTS[variant])
    click.echo(f"{target}: {count} objects, {variant}; next: cazsl-train data check {target}")
