"""``cazsl-train data``: check folders of pushes, write report pages of them, and export them in other variants."""

from pathlib import Path
from typing import Final

import click

from service.cli.command_line import ANY_PATH, FOLDER, argument, option
from service.cli.terminal import echo, print_json
from training.inspection.inspection import inspect
from training.inspection.text import inspection_document, inspection_lines
from training.omnipush.files import Variant
from training.omnipush.pushes import export_variants, read_folder

VARIANTS: Final = {"raw": (Variant.RAW,), "normalised": (Variant.NORMALISED,), "both": tuple(Variant)}
folder_argument = argument("folder", type=ANY_PATH)


@click.group("data")
def data() -> None:
    """Check folders of pushes, draw them, and export them as Omnipush was published.

    \b
    cazsl-train data check data/omnipush           content and faults of a copy of Omnipush
    cazsl-train data report data/approach/abs      a page with statistics, histograms and a gallery of pushes
    cazsl-train data export data/approach/abs OUT  the same pushes, raw and normalised
    """


@data.command("check", short_help="Check that a folder is complete, like Omnipush, and fit to train on.")
@folder_argument
@option("--json", "as_json", is_flag=True, help="Print one JSON document instead of the table.")
def check(folder: Path, as_json: bool) -> None:
    """Check a copy of Omnipush, or a folder in its format, and print its content and its faults.

    FOLDER is one surface's folder, or one above several (abs or 0,1,2_weights, plywood, top-down_view). Every file is
    read. Objects are matched to the published lists up to rotation by whole sides. Exit status 1 means that training
    on the folder would be wrong, for the reasons listed as errors. Warnings are for you to judge.
    """
    inspection = inspect(folder)
    if as_json:
        print_json(inspection_document(inspection))
    else:
        for line in inspection_lines(inspection):
            echo(line)
    if not inspection.fit_to_train_on:
        click.get_current_context().exit(1)


@data.command("report", short_help="Write a page with statistics, histograms and a gallery of pushes.")
@folder_argument
@option(
    "--out",
    type=FOLDER,
    help="Folder of the page and its images. [default: FOLDER/report]",
)
def report(folder: Path, out: Path | None) -> None:
    """Write report.md, histograms.png and pushes.png of one surface's pushes in FOLDER.

    The page has the statistics of the pushes beside the published ones of Omnipush, the quantiles of displacement and
    rotation, histograms, and a gallery of pushes. The same pushes give the same files.
    """
    pushes = read_folder(folder)
    from training.inspection.dataset_page import write_report  # slow to import, as matplotlib is

    page, *images = write_report(pushes, out or folder / "report")
    names = " and ".join(path.name for path in images)
    echo(f"{page}: {len(pushes.descriptors)} objects, {pushes.count} pushes, with {names}; next: read {page}")


@data.command("export", short_help="Write a folder again, raw, normalised or both.")
@folder_argument
@argument("target", type=ANY_PATH)
@option(
    "--variant",
    type=click.Choice(list(VARIANTS)),
    default="both",
    show_default=True,
    help="raw: metres and radians. normalised: minus the published mean, divided by the published deviation.",
)
def export(folder: Path, target: Path, variant: str) -> None:
    """Write one surface's pushes of FOLDER into TARGET as Omnipush was published, with their declared source."""
    count = export_variants(folder, target, VARIANTS[variant])
    echo(f"{target}: {count} objects, {variant}; next: cazsl-train data check {target}")
