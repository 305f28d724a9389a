"""Text and JSON of an inspection of a table."""

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from training.inspection.tables.inspection import TableInspection
from training.inspection.text import counted_findings, finding_document, finding_lines, motion_document, motion_lines


def table_lines(found: TableInspection) -> Iterator[str]:
    """Return the lines of the report, the findings, and the next step."""
    table, geometry = found.table, found.geometry
    fewest, median, most = found.rows
    clearance = 1e3 * np.quantile(geometry.start_m, (0.05, 0.5, 0.95))
    lengths, radii = 1e3 * table.pushers[:, 3], 1e3 * table.pusher_radius_m
    yield f"{found.path}: {table.source}"
    yield f"  objects  {len(table.objects)}, {', '.join(item.name for item in table.objects[:5])}{_more(table.objects)}"
    yield f"  pushes   {table.count}, {fewest} to {most} an object, median {median:g}"
    yield f"  surfaces {', '.join(table.surfaces[:10])}{' ...' if len(table.surfaces) > 10 else ''}"
    yield f"  pusher   radius {_span(radii)} mm, length {_span(lengths)} mm"
    yield f"  start    clearance {' / '.join(f'{value:.1f}' for value in clearance)} mm (5, 50, 95 %)"
    yield f"  contact  {100 * geometry.reaches.mean():.1f} % of the paths meet the outline"
    if table.peers:
        yield f"  peers    {', '.join(table.peers)}"
    if table.labels:
        yield f"  labels   {', '.join(table.labels)}"
    if table.ignored:
        yield f"  not read {', '.join(table.ignored)}"
    yield f"  sha256   {table.digest}"
    yield from (f"  {line}" for line in motion_lines(found.motion, found.other))
    yield ""
    yield from finding_lines(found.findings)
    yield next_step(found)


def next_step(found: TableInspection) -> str:
    """Return the last line: the number of findings, and the next step."""
    count = counted_findings(found.findings)
    if not found.fit_to_train_on:
        return f"{count}; next: fix the errors, then cazsl-train data check {found.path}"
    return f"{count}; next: cazsl-train data report {found.path}"


def table_document(found: TableInspection) -> dict[str, Any]:
    """Return the report as a JSON document, in the names of the text."""
    table = found.table
    fewest, median, most = found.rows
    return {
        "table": str(found.path),
        "fit_to_train_on": found.fit_to_train_on,
        "source": table.source,
        "sha256": table.digest,
        "objects": len(table.objects),
        "pushes": table.count,
        "surfaces": list(table.surfaces),
        "rows_per_object": {"min": fewest, "median": median, "max": most},
        "peers": list(table.peers),
        "labels": list(table.labels),
        "not_read": list(table.ignored),
        "reaches_share": float(found.geometry.reaches.mean()),
        "motion": motion_document(found.motion),
        "against": None if found.other is None else {"name": found.other[0], **motion_document(found.other[1])},
        "findings": [finding_document(each) for each in found.findings],
        "next": next_step(found),
    }


def _span(values: Any) -> str:
    low, high = float(values.min()), float(values.max())
    return f"{low:.4g}" if math.isclose(low, high, rel_tol=1e-3) else f"{low:.4g} to {high:.4g}"


def _more(objects: tuple[Any, ...]) -> str:
    return " ..." if len(objects) > 5 else ""
