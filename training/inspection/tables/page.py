"""Report page of a table: figures and quantiles, distributions and a gallery, beside another table's."""

import warnings
from pathlib import Path
from typing import Final

from service.storage.disk import replace_whole
from training.inspection.statistics import QUANTILES, MotionQuantiles, motion_quantiles
from training.inspection.tables.figures import distributions, gallery, plain
from training.inspection.tables.geometry import PushGeometry, push_geometry
from training.tables.push_table import PushTable

REPORT_FILE: Final = "report.md"
HISTOGRAMS_FILE: Final = "histograms.png"
GALLERY_FILE: Final = "pushes.png"
_SHOWN: Final = 20  # objects that are named


def write_report(
    table: PushTable, out: Path, other: tuple[str, PushTable] | None = None, seed: int = 0, quiet: bool = False
) -> tuple[Path, ...]:
    """Write ``report.md`` with its two images into a folder. The same pushes give the same files.

    Args:
        table: the pushes.
        out: the folder, made if it is missing.
        other: name and pushes of another table, drawn beside.
        seed: the choice of pushes in the gallery.
        quiet: no progress bar.

    Returns:
        The paths of the files written: page, histograms, gallery.

    Raises:
        OSError: the folder cannot be written.
    """
    out.mkdir(parents=True, exist_ok=True)
    files = tuple(out / name for name in (REPORT_FILE, HISTOGRAMS_FILE, GALLERY_FILE))
    geometry = push_geometry(table, quiet)
    beside = None if other is None else (*other, push_geometry(other[1], quiet))
    replace_whole(files[0], report(table, geometry, other).encode())
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Glyph")  # of a script that the font lacks: boxes are drawn instead
        # without dates and versions in the images, so that equal data give equal files
        figure = distributions((table.source, table, geometry), beside)
        figure.savefig(files[1], dpi=100, metadata={"Software": None})
        gallery(table, seed).savefig(files[2], dpi=100, metadata={"Software": None})
    return files


def report(table: PushTable, geometry: PushGeometry, other: tuple[str, PushTable] | None = None) -> str:
    """Return the Markdown page."""
    names = ", ".join(_cell(item.name) for item in table.objects[:_SHOWN])
    tables = [("", table)] if other is None else [("", table), other]
    lines = [
        f"# {_cell(table.source)}",
        "",
        f"{counted_table(table)} ({names}{' ...' if len(table.objects) > _SHOWN else ''}), "
        f"surfaces: {', '.join(_cell(name) for name in table.surfaces[:_SHOWN])}. "
        f"{100 * (1 - geometry.reaches.mean()):.2f} % of the paths miss the object. "
        f"sha256 of the content `{table.digest}`. Written by `cazsl-train data report`.",
        "",
        "| of the pushes that moved the object by over 1 mm | "
        + " | ".join(f"{100 * q:.0f} %" for q in QUANTILES)
        + " |",
        "|---|" + "---|" * len(QUANTILES),
        *(row for name, each in tables for row in _rows(name, motion_quantiles(each.outcomes))),
        "",
        "| did not move | share of the pushes |",
        "|---|---|",
        *(
            f"| {_cell(name) or 'here'} | {100 * motion_quantiles(each.outcomes).still_share:.1f} % |"
            for name, each in tables
        ),
        "",
        f"![Distributions of starts, aims, lengths, distances and turns]({HISTOGRAMS_FILE})",
        "",
        f"![Outline at the start in grey and at the end in blue, path and tip of the pusher in orange]({GALLERY_FILE})",
        "",
    ]
    return "\n".join(lines)


def counted_table(table: PushTable) -> str:
    """Return the number of pushes and of objects of a table."""
    pushes, objects = "push" if table.count == 1 else "pushes", "object" if len(table.objects) == 1 else "objects"
    return f"{table.count} {pushes} of {len(table.objects)} {objects}"


def _rows(name: str, motion: MotionQuantiles) -> list[str]:
    label = f", {_cell(name)}" if name else ""
    return [
        f"| {quantity}{label} | " + " | ".join(f"{value:.1f}" for value in values) + " |"
        for quantity, values in (("distance (mm)", motion.distance_mm), ("turn (degrees)", motion.turn_deg))
    ]


def _cell(text: str) -> str:
    """Return a text of other people for a cell of a table in Markdown."""
    shown = plain(text).replace(r"\$", "$")
    return "".join(f"\\{each}" if each in r"\`*_{}[]<>()#|!&" else each for each in shown)
