"""Geometry of recorded pushes: the tip against the outline, before and after the push.

All figures follow from the outline, the pusher and the outcome alone, without mechanics or friction. So they hold for
any object: a tip starts outside, pushes and does not pull, cannot move the centroid farther than it goes itself, and
ends outside the outline where the object then lies.
"""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from tqdm import tqdm

from service.pushing.first_contact import first_contact
from service.pushing.outlines import Outline
from service.pushing.poses import DoubleArray
from training.inspection.statistics import missed
from training.tables.push_table import PushTable

NEAR_M: Final = 0.003  # paths that pass this near count as touching: outlines and trackers are no better

Rows = npt.NDArray[np.int64]


@dataclass(frozen=True)
class PushGeometry:
    """Geometry of n pushes: each array has a value per push, (n,)."""

    start_m: DoubleArray
    """Clearance between tip and outline before the push, negative if they overlap."""
    travel_m: DoubleArray
    """Travel of the tip until it comes near the outline, inf if it passes by."""
    end_m: DoubleArray
    """Clearance between tip and outline after the push, negative if they overlap."""
    motion_m: DoubleArray
    """Distance that the centroid moved."""
    along_m: DoubleArray
    """Motion of the centroid in the direction of the push."""
    moved: npt.NDArray[np.bool_]
    """Mask of the pushes that moved the object."""

    @property
    def reaches(self) -> npt.NDArray[np.bool_]:
        """Mask of the pushes whose path comes near the outline."""
        return np.isfinite(self.travel_m)


def push_geometry(table: PushTable, quiet: bool = True) -> PushGeometry:
    """Measure every push of a table."""
    columns = {name: np.empty(table.count) for name in ("start_m", "travel_m", "end_m", "motion_m", "along_m")}
    groups = rows_by_object(table)
    for number, rows in tqdm(groups, desc="measuring", unit="object", disable=True if quiet else None, leave=False):
        outline = table.objects[number].outline
        pushers, radius_m, outcomes = table.pushers[rows], table.pusher_radius_m[rows], table.outcomes[rows]
        columns["start_m"][rows] = outline.distance_m(pushers[:, :2]) - radius_m
        columns["travel_m"][rows] = first_contact(outline, pushers, radius_m + NEAR_M).travel_m
        columns["end_m"][rows] = end_clearance_m(outline, pushers, radius_m, outcomes)
        motion = centroid_motion(outline, outcomes)
        columns["motion_m"][rows] = np.hypot(motion[:, 0], motion[:, 1])
        columns["along_m"][rows] = (motion * directions(pushers)).sum(axis=1)
    return PushGeometry(**columns, moved=~missed(table.outcomes))


def rows_by_object(table: PushTable) -> list[tuple[int, Rows]]:
    """Return the number of each object that has pushes, and their rows."""
    order = np.argsort(table.object_index, kind="stable")
    numbers, starts = np.unique(table.object_index[order], return_index=True)
    return list(zip(numbers.tolist(), np.split(order, starts[1:]), strict=True))


def directions(pushers: DoubleArray) -> DoubleArray:
    """Return the unit vectors (n, 2) of pushers (n, 4)."""
    return np.column_stack([np.cos(pushers[:, 2]), np.sin(pushers[:, 2])])


def end_clearance_m(
    outline: Outline, pushers: DoubleArray, radius_m: DoubleArray, outcomes: DoubleArray
) -> DoubleArray:
    """Return the clearance (n,) of the tip at the end of its path from the outline at the outcome."""
    end = pushers[:, :2] + pushers[:, 3:] * directions(pushers) - outcomes[:, :2]
    cos, sin = np.cos(outcomes[:, 2]), np.sin(outcomes[:, 2])
    local = np.column_stack([cos * end[:, 0] + sin * end[:, 1], cos * end[:, 1] - sin * end[:, 0]])
    return np.asarray(outline.distance_m(local) - radius_m)


def centroid_motion(outline: Outline, outcomes: DoubleArray) -> DoubleArray:
    """Return the vector (n, 2) by which the centroid of an outline moved to its outcomes (n, 3)."""
    x_m, y_m = outline.centroid_m
    cos, sin = np.cos(outcomes[:, 2]), np.sin(outcomes[:, 2])
    turned: Any = np.column_stack([cos * x_m - sin * y_m - x_m, sin * x_m + cos * y_m - y_m])
    return np.asarray(outcomes[:, :2] + turned)
