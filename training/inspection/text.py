"""Text and JSON of an inspection."""

import math
from collections.abc import Iterable, Iterator, Sequence
from typing import Any, Final

from training.inspection.findings import DatasetFinding, Severity
from training.inspection.inspection import Inspection, SurfaceReport
from training.inspection.object_lists import Membership
from training.inspection.statistics import QUANTILES, MotionQuantiles, QuantityStatistics, recorded_motion
from training.omnipush.layout import SurfaceKind

SHOWN: Final = 20  # findings of one severity in the text; --json has all of them


def inspection_lines(inspection: Inspection) -> Iterator[str]:
    """Return the lines of the report, the findings, and the next step."""
    for report in inspection.surfaces:
        yield from _surface_lines(report)
        yield ""
    yield from finding_lines(inspection.findings)
    yield next_step(inspection)


def finding_lines(findings: Sequence[DatasetFinding]) -> Iterator[str]:
    """Return the lines of findings, errors first."""
    for severity in Severity:
        found = [finding for finding in findings if finding.severity is severity]
        if found:
            yield f"{severity}s, on which training would be wrong:" if severity is Severity.ERROR else f"{severity}s:"
        for finding in found[:SHOWN]:
            yield f"  {finding.code}: {_located(finding)}"
        if len(found) > SHOWN:
            yield f"  ... and {len(found) - SHOWN} more; --json lists all"


def counted_findings(findings: Sequence[DatasetFinding]) -> str:
    """Return the number of errors and of warnings."""
    errors, warnings = (sum(each.severity is severity for each in findings) for severity in Severity)
    return f"{errors} {'error' if errors == 1 else 'errors'}, {warnings} {'warning' if warnings == 1 else 'warnings'}"


def finding_document(finding: DatasetFinding) -> dict[str, str]:
    """Return a finding as a JSON document."""
    return {"severity": finding.severity, "code": finding.code, "where": finding.where, "message": finding.message}


def next_step(inspection: Inspection) -> str:
    """Return the last line: the number of findings, and the next step."""
    count = counted_findings(inspection.findings)
    if not inspection.fit_to_train_on:
        return f"{count}; next: fix the errors, then cazsl-train data check {inspection.folder}"
    trained = [report.folder for report in inspection.surfaces if report.surface is SurfaceKind.ABS]
    if not trained:
        return f"{count}; next: train on ABS and use this surface to test: cazsl-train fit push-indicator"
    return f"{count}; next: cazsl-train fit push-indicator --data {trained[0]}"


def inspection_document(inspection: Inspection) -> dict[str, Any]:
    """Return the report as a JSON document, in SI units, with the names of the text."""
    return {
        "folder": str(inspection.folder),
        "fit_to_train_on": inspection.fit_to_train_on,
        "surfaces": [_surface_document(report) for report in inspection.surfaces],
        "findings": [finding_document(found) for found in inspection.findings],
        "next": next_step(inspection),
    }


def statistics_lines(figures: Iterable[QuantityStatistics]) -> Iterator[str]:
    """Return the lines of a table of statistics beside the published ones."""
    yield f"{'':18}{'mean':>10}{'published':>11}{'std':>10}{'published':>11}{'ratio':>7}"
    for figure in figures:
        yield (
            f"{figure.quantity:18}{figure.mean:10.5f}{figure.published_mean:11.5f}"
            f"{figure.std:10.5f}{figure.published_std:11.5f}{figure.ratio:7.3f}"
        )


def motion_lines(motion: MotionQuantiles, other: tuple[str, MotionQuantiles] | None = None) -> Iterator[str]:
    """Return the lines of a table of the motion, beside that of other pushes."""
    yield f"{'':26}" + "".join(f"{100 * level:>7.0f} %" for level in QUANTILES) + "   did not move"
    for name, each in (("", motion), *(() if other is None else (other,))):
        label = f" {name[:20]}" if name else ""
        yield (
            f"{'distance (mm)' if not name else label:26}"
            + _cells(each.distance_mm)
            + f"{100 * each.still_share:>13.1f} %"
        )
    for name, each in (("", motion), *(() if other is None else (other,))):
        yield f"{'turn (degrees)' if not name else f' {name[:20]}':26}" + _cells(each.turn_deg)


def motion_document(motion: MotionQuantiles) -> dict[str, Any]:
    """Return quantiles of the motion as a JSON document, null where no push moved the object."""

    def values(row: tuple[float, ...]) -> list[float | None]:
        return [None if math.isnan(value) else value for value in row]

    return {
        "still_share": motion.still_share,
        "quantiles": list(QUANTILES),
        "distance_mm": values(motion.distance_mm),
        "turn_deg": values(motion.turn_deg),
    }


def _located(finding: DatasetFinding) -> str:
    """Return the message, with the surface in front unless the message names its file."""
    return finding.message if finding.where in finding.message else f"{finding.where}: {finding.message}"


def _surface_lines(report: SurfaceReport) -> Iterator[str]:
    fewest, median, most = report.rows
    precisions = ", ".join(f"{count} {dtype}" for dtype, count in sorted(report.dtypes.items()))
    yield f"{report.folder}: {report.surface}, {report.source}"
    yield f"  objects  {report.objects}: {_members(report.membership)}"
    yield f"  pushes   {report.pushes}, {fewest} to {most} an object, median {median:g}"
    yield f"  files    {report.raw_pairs} raw pairs, {report.normalised_pairs} normalised; {precisions}"
    yield f"  contact  {100 * report.missed_share:.2f} % of the pushes did not move the object"
    yield f"  views    {report.views} of {report.objects} objects have a top-down view"
    yield from (f"  {line}" for line in statistics_lines(report.figures))
    if report.motion is not None:
        yield "  objects without weights, pushes that moved them by over 1 mm:"
        yield from (f"  {line}" for line in motion_lines(report.motion, ("recorded", recorded_motion())))


def _members(found: Membership) -> str:
    parts = [f"{len(each.present)} of {len(each.present) + len(each.missing)} {each.name}" for each in found.lists]
    return ", ".join([*parts, f"{len(found.turned)} under a turned name", f"{len(found.extra)} extra"])


def _surface_document(report: SurfaceReport) -> dict[str, Any]:
    fewest, median, most = report.rows
    return {
        "surface": report.surface,
        "folder": str(report.folder),
        "source": report.source,
        "objects": report.objects,
        "pushes": report.pushes,
        "rows_per_object": {"min": fewest, "median": median, "max": most},
        "raw_pairs": report.raw_pairs,
        "normalised_pairs": report.normalised_pairs,
        "dtypes": report.dtypes,
        "missed_share": report.missed_share,
        "views": report.views,
        "motion": None if report.motion is None else motion_document(report.motion),
        "recorded_motion": motion_document(recorded_motion()),
        "statistics": {
            figure.quantity: {
                "mean": figure.mean,
                "published_mean": figure.published_mean,
                "std": figure.std,
                "published_std": figure.published_std,
            }
            for figure in report.figures
        },
        "published_objects": {
            each.name: {"present": each.present, "missing": each.missing} for each in report.membership.lists
        },
        "turned": report.membership.turned,
        "extra": report.membership.extra,
    }


def _cells(values: tuple[float, ...]) -> str:
    return "".join(f"{value:>9.1f}" for value in values)
