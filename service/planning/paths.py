"""Paths of planned pushes: which pushes keep object and tip clear of what surrounds them.

An object moves from pose to pose, and a tip along its straight travel. Both are sampled so densely, along the outline
and along the way, that no place between two samples is further than the clearance from the nearest one. So a path whose
samples keep the clearance touches nothing between them. Poses between two pushes are taken to be even steps.

The tip comes down from above at the start of a push and is lifted at its end, so ways between pushes are not checked.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
import numpy.typing as npt

from service.planning.particles import moved
from service.planning.surroundings import Surroundings
from service.pushing.outlines import Outline
from service.pushing.poses import DoubleArray, wrap_angles
from service.turns import pause

Rows = npt.NDArray[np.bool_]
MOST_POINTS: Final = 256  # of an outline
MOST_STEPS: Final = 64  # of a tip's way
FINE_M: Final = 0.005  # between samples, whatever the clearance
MOST_OF_OBJECT: Final = 4 * MOST_STEPS  # of an object's, whose corners go further as it turns
_POINTS_AT_ONCE: Final = 1 << 14


@dataclass(frozen=True, eq=False)
class Paths:
    """Checks of the paths of one object and the tip that pushes it.

    Attributes:
        surroundings: in the world.
        outline: of the object, in its frame.
        radius_m: of the tip.
        longest_m: length of the longest push.
        clearance_m: that object and tip keep.
        is_over: function that returns true if the time is over. Paths that are not checked then count as not free.
    """

    surroundings: Surroundings
    outline: Outline
    radius_m: float
    longest_m: float
    clearance_m: float
    is_over: Callable[[], bool] = lambda: False

    @cached_property
    def spacing_m(self) -> float:
        """Return the distance between samples: the clearance, at most ``FINE_M``, or more for few samples."""
        fine_m = min(self.clearance_m, FINE_M)
        return max(fine_m, self.outline.perimeter_m / MOST_POINTS, self.longest_m / MOST_STEPS)

    @cached_property
    def kept_m(self) -> float:
        """Return the distance that samples keep: the clearance, and no less than the distance between them."""
        return max(self.clearance_m, self.spacing_m)

    @cached_property
    def _points(self) -> DoubleArray:
        """Return points (n, 2) along the outline, from its centroid."""
        edges = self.outline.edges
        lengths = np.hypot(edges[:, 0], edges[:, 1])
        parts = []
        for corner, edge, length in zip(self.outline.corners, edges, lengths, strict=True):
            count = max(1, int(np.ceil(length / self.spacing_m)))
            parts.append(corner + edge * (np.arange(count)[:, None] / count))
        return np.concatenate(parts) - self.outline.centroid_m

    @cached_property
    def reach_m(self) -> float:
        """Return the largest distance of the outline from its centroid."""
        apart = self.outline.corners - self.outline.centroid_m
        return float(np.hypot(apart[:, 0], apart[:, 1]).max())

    @cached_property
    def furthest_m(self) -> float:
        """Return the largest distance of the outline from the origin of its frame."""
        return float(np.hypot(self.outline.corners[:, 0], self.outline.corners[:, 1]).max())

    def gap_m(self, pose: DoubleArray) -> float:
        """Return how far the object at a pose (3,) is from what is forbidden, exactly, or -inf if it overlaps it.

        The distance of two polygons that do not overlap is that of a corner of one from the other.
        """
        corners = _placed(self.outline.corners - self.outline.centroid_m, self._centres(pose[None]))[0]
        there = Outline(corners)
        found = np.inf
        for obstacle in self.surroundings.obstacles:
            apart = min(float(obstacle.distance_m(corners).min()), float(there.distance_m(obstacle.corners).min()))
            found = min(found, -np.inf if apart <= 0.0 or _cross(there, obstacle) else apart)
        workspace = self.surroundings.workspace
        if workspace is not None:
            apart = min(-float(workspace.distance_m(corners).max()), float(there.distance_m(workspace.corners).min()))
            found = min(found, -np.inf if apart <= 0.0 or _cross(there, workspace) else apart)
        return found

    def free(
        self,
        before: DoubleArray,
        after: DoubleArray,
        pushes: DoubleArray,
        least_m: float,
        spread_m: npt.ArrayLike = 0.0,
    ) -> Rows:
        """Return (n,) true for pushes (n, 4) in the world that move the object between poses (n, 3) and touch nothing.

        Args:
            before: poses before each push.
            after: poses after it.
            pushes: x_m, y_m, angle_rad, length_m of the tip.
            least_m: distance that samples keep.
            spread_m: distance that the object keeps beside that at the end of each push, (n,) or one for all. It
                grows along the way from none.
        """
        found = np.ones(len(pushes), dtype=np.bool_)
        if self.surroundings.is_empty or not len(pushes):
            return found
        travel = np.linspace(0.0, 1.0, self._steps(float(pushes[:, 3].max())))[None, :, None] * pushes[:, None, 3:]
        ahead = np.stack([np.cos(pushes[:, 2]), np.sin(pushes[:, 2])], axis=1)
        tips = pushes[:, None, :2] + travel * ahead[:, None, :]
        found &= (
            self.surroundings.keeps(tips.reshape(-1, 2), self.radius_m + least_m).reshape(len(found), -1).all(axis=1)
        )
        rows = np.flatnonzero(found)
        if not len(rows):
            return found
        start = self._centres(before[rows])
        change = self._centres(after[rows]) - start
        change[:, 2] = wrap_angles(change[:, 2])
        way = float((np.hypot(change[:, 0], change[:, 1]) + np.abs(change[:, 2]) * self.reach_m).max())
        share = np.linspace(0.0, 1.0, self._steps(way))[1:]
        poses = start[:, None, :] + share[None, :, None] * change[:, None, :]
        least = least_m + np.broadcast_to(np.asarray(spread_m), len(pushes))[rows, None] * share
        found[rows] = self._poses_free(poses.reshape(-1, 3), least.ravel()).reshape(len(rows), -1).all(axis=1)
        return found

    def _steps(self, way_m: float) -> int:
        """Return the samples of a way. Those of a tip are always near enough to each other, see ``kept_m``."""
        return min(MOST_OF_OBJECT, max(1, int(np.ceil(way_m / self.spacing_m)))) + 1

    def _centres(self, poses: DoubleArray) -> DoubleArray:
        """Return the poses (n, 3) of a frame at the centroid, of an object at poses (n, 3)."""
        return moved(poses, np.append(self.outline.centroid_m, 0.0))

    def _poses_free(self, poses: DoubleArray, least_m: DoubleArray) -> Rows:
        """Return (n,) true for poses (n, 3) of the centroid at which the outline keeps a distance (n,)."""
        found = self.surroundings.keeps(poses[:, :2], self.reach_m + least_m)
        doubtful = np.flatnonzero(~found)
        together = max(1, _POINTS_AT_ONCE // len(self._points))
        for first in range(0, len(doubtful), together):
            if self.is_over():
                break
            rows = doubtful[first : first + together]
            points = _placed(self._points, poses[rows]).reshape(-1, 2)
            kept = self.surroundings.keeps(points, np.repeat(least_m[rows], len(self._points)))
            found[rows] = kept.reshape(len(rows), -1).all(axis=1)
            pause()
        return found


def _placed(points: DoubleArray, poses: DoubleArray) -> DoubleArray:
    """Return points (k, 2) of an object at poses (n, 3), as (n, k, 2) in the world."""
    cos, sin = np.cos(poses[:, 2, None]), np.sin(poses[:, 2, None])
    x, y = points.T
    return np.stack([poses[:, :1] + cos * x - sin * y, poses[:, 1:2] + sin * x + cos * y], axis=-1)


def _cross(first: Outline, second: Outline) -> bool:
    """Return whether an edge of one outline crosses one of the other."""

    def sides(of: Outline, points: DoubleArray) -> DoubleArray:
        """Return (edge, point) positive where a point is on the left of an edge."""
        offset = points[None] - of.corners[:, None]
        found: DoubleArray = of.edges[:, None, 0] * offset[..., 1] - of.edges[:, None, 1] * offset[..., 0]
        return found

    def parted(of: Outline, other: Outline) -> Rows:
        """Return (edge of one, edge of the other) true where the ends of the other edge are on both sides."""
        side = sides(of, other.corners)
        return side * np.roll(side, -1, axis=1) < 0.0

    return bool((parted(first, second) & parted(second, first).T).any())
