"""``cazsl-train data``: check pushes, write report pages of them, and export them in other variants.

A path is a table of pushes of any objects, or a folder in Omnipush's format.
"""

from collections.abc import Iterable
from pathlib import Path
from typing import Final

import click

from service.cli.command_line import ANY_PATH, FILE, FOLDER, argument, errors_as_one_line, option
from service.cli.terminal import echo, print_json
from training.inspection.inspection import inspect
from training.inspection.statistics import MotionQuantiles, motion_quantiles, recorded_motion
from training.inspection.tables.inspection import inspect_table
from training.inspection.tables.text import table_document, table_lines
from training.inspection.text import inspection_document, inspection_lines
from training.omnipush.files import Variant
from training.omnipush.pushes import export_variants, read_folder
from training.tables.files import is_table
from training.tables.reading import read_table

RECORDINGS: Final = "omnipush"
VARIANTS: Final = {"raw": (Variant.RAW,), "normalised": (Variant.NORMALISED,), "both": tuple(Variant)}
folder_argument = argument("folder", type=ANY_PATH)


path_argument = argument("path", type=ANY_PATH)
objects_option = option(
    "--objects",
    "objects_file",
    type=FILE,
    help="File of the outlines of a table. [default: objects.* or outlines.* beside the pushes]",
)
against_option = option(
    "--against",
    type=ANY_PATH,
    help="Other pushes, to stand beside those of a table: a table; for check also a folder in Omnipush's format, or "
    f"the word {RECORDINGS} for the quantiles of its recordings.",
)


@click.group("data")
def data() -> None:
    """Check pushes, draw them, and export them as Omnipush was published.

    \b
    cazsl-train data check data/omnipush           content and faults of a copy of Omnipush
    cazsl-train data check my-pushes               the same of a table of your own (docs/data.md, Your own pushes)
    cazsl-train data report data/approach/abs      a page with statistics, histograms and a gallery of pushes
    cazsl-train data export data/approach/abs OUT  the same pushes, raw and normalised
    """


@data.command("check", short_help="Check that pushes are complete, plausible, and fit to train on.")
@path_argument
@objects_option
@against_option
@option("--json", "as_json", is_flag=True, help="Print one JSON document instead of the text.")
@errors_as_one_line
def check(path: Path, objects_file: Path | None, against: Path | None, as_json: bool) -> None:
    """Check a table of pushes, a copy of Omnipush, or a folder in its format: print content and faults.

    PATH is a table (a folder with pushes.csv or pushes.parquet, or such a file), one surface's folder in Omnipush's
    format, or one above several (abs or 0,1,2_weights, plywood, top-down_view). Every file is read. Objects of
    Omnipush are matched to the published lists up to rotation by whole sides. Pushes of a table are held against the
    outlines: units, frames, pushes that are impossible, rows that occur twice, too few of them.

    Exit status 1 means that training on the pushes would be wrong, for the reasons listed as errors. Warnings are for
    you to judge.
    """
    lines: Iterable[str]
    if is_table(path):
        table = read_table(path, objects_file)
        table_inspection = inspect_table(path, table, _other(against))
        document, lines = table_document(table_inspection), table_lines(table_inspection)
        is_fit = table_inspection.fit_to_train_on
    else:
        _tables_only(path, objects_file, against)
        inspection = inspect(path)
        document, lines = inspection_document(inspection), inspection_lines(inspection)
        is_fit = inspection.fit_to_train_on
    if as_json:
        print_json(document)
    else:
        for line in lines:
            echo(line)
    if not is_fit:
        click.get_current_context().exit(1)


def _other(against: Path | None) -> tuple[str, MotionQuantiles] | None:
    """Return the name and the quantiles of other pushes: a table, a folder in Omnipush's format, or its recordings."""
    if against is None:
        return None
    if str(against) == RECORDINGS and not against.exists():
        return "Omnipush's recordings", recorded_motion()
    outcomes = read_table(against).outcomes if is_table(against) else read_folder(against).rows()[1]
    return against.name, motion_quantiles(outcomes)


def _tables_only(path: Path, objects_file: Path | None, against: Path | None) -> None:
    """Refuse options of tables for a folder in Omnipush's format."""
    for name, value in (("--objects", objects_file), ("--against", against)):
        if value is not None:
            raise click.UsageError(f"{name} is for tables, and {path} holds neither pushes.csv nor pushes.parquet.")


@data.command("report", short_help="Write a page with statistics, histograms and a gallery of pushes.")
@path_argument
@objects_option
@against_option
@option("--out", type=FOLDER, help="Folder of the page and its images. [default: report beside the pushes]")
def report(path: Path, objects_file: Path | None, against: Path | None, out: Path | None) -> None:
    """Write report.md, histograms.png and pushes.png of the pushes at PATH.

    The page has statistics and quantiles of the motion, histograms of the pushes, and a gallery of single pushes. For a
    table they stand beside another table's (--against), for a folder in Omnipush's format beside the published ones.
    The same pushes give the same files.
    """
    out = out or (path if path.is_dir() else path.parent) / "report"
    if is_table(path):
        table = read_table(path, objects_file)
        other = None if against is None else (against.name, read_table(against))
        from training.inspection.tables.page import counted_table  # slow to import, as matplotlib is
        from training.inspection.tables.page import write_report as write_table_report

        page, *images = write_table_report(table, out, other)
        count = counted_table(table)
    else:
        _tables_only(path, objects_file, against)
        pushes = read_folder(path)
        from training.inspection.dataset_page import write_report  # slow to import, as matplotlib is

        page, *images = write_report(pushes, out)
        count = f"{len(pushes.descriptors)} objects, {pushes.count} pushes"
    names = " and ".join(image.name for image in images)
    echo(f"{page}: {count}, with {names}; next: read {page}")


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
