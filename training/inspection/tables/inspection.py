"""Inspection of a table of pushes: is it in metres, in the frame of its outlines, possible, and enough?"""

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from training.inspection.findings import DatasetFinding, Judged, odd_angles, odd_quantiles
from training.inspection.statistics import MotionQuantiles, motion_quantiles
from training.inspection.tables.findings import (
    odd_motion,
    odd_objects,
    odd_pushes,
    odd_repeats,
    odd_scatter,
)
from training.inspection.tables.frames import odd_frames, odd_units
from training.inspection.tables.geometry import PushGeometry, push_geometry, rows_by_object
from training.tables.push_table import PushTable

ENOUGH_PUSHES: Final = 100  # fewer have no quantiles to compare


@dataclass(frozen=True)
class TableInspection(Judged):
    """Inspection of a table: its figures, and the findings."""

    path: Path
    table: PushTable
    rows: tuple[int, float, int]  # per object: fewest, median, most
    geometry: PushGeometry
    motion: MotionQuantiles
    other: tuple[str, MotionQuantiles] | None  # name and motion of the table beside it
    findings: tuple[DatasetFinding, ...]


def inspect_table(
    path: Path, table: PushTable, other: tuple[str, MotionQuantiles] | None = None, quiet: bool = False
) -> TableInspection:
    """Inspect a table. Wrong units suppress the findings that only follow from them, and a wrong frame likewise.

    Args:
        path: its place, for the messages.
        table: the pushes.
        other: name and quantiles of another dataset, to compare with.
        quiet: no progress bar.
    """
    where = str(path)
    counts = [len(rows) for _, rows in rows_by_object(table)]
    geometry = push_geometry(table, quiet)
    motion = motion_quantiles(table.outcomes)
    findings = list(odd_units(where, table))
    if not findings:
        findings += odd_frames(where, table, geometry)
        fits = not findings
        findings += odd_angles(where, table.pushers[:, :3], table.outcomes)
        if fits:
            findings += [*odd_pushes(where, table, geometry), *odd_motion(where, table, geometry)]
            findings += odd_scatter(where, table)
            if other and table.count >= ENOUGH_PUSHES:
                findings += odd_quantiles(where, motion, other[1], other[0])
    findings += [*odd_repeats(where, table), *odd_objects(where, table)]
    rows = (min(counts), float(np.median(counts)), max(counts))
    return TableInspection(path, table, rows, geometry, motion, other, tuple(findings))
