"""Search of sequences of pushes that bring an object from a pose to a goal: a beam over the motions of candidates.

Quasi-static pushing on an even table does not depend on where the object stands, so the outcome of a push is a motion
in the object's own frame. It is predicted once for each candidate. Sequences are then products of motions, and cost no
prediction: a step of the search composes all candidates with all poses of the beam.

A sequence of d pushes costs d, and a failure costs ``FAILURE`` pushes more, by the probability of ending outside of
the goal. The deviation at its end is that of its last push, with ``KEPT`` of the variance from the pushes before it,
because a robot plans again after each push. So few and sure pushes win. The beam has the poses that are nearest to the
goal, by distance and turn in units of a far push. One pose of each cell comes first, so that it keeps different ways.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from service.planning.candidates import Candidates
from service.planning.particles import Region, moved
from service.pushing.poses import DoubleArray, wrap_angles
from service.turns import pause

FAILURE: Final = 3.0  # pushes that a failure costs
KEPT: Final = 0.25  # share of the variance before a push that replanning leaves
_CELL: Final = 0.35  # of a far push and a far turn
_FAR: Final = 0.9  # quantile of the candidates' motions
_TRIED: Final = 16  # times the width: poses that are looked at for a beam
_CHECKED: Final = 64  # paths into the goal that are checked in one step
_ROWS_AT_ONCE: Final = 1 << 14  # ends between two pauses
_LEAST: Final = 1e-6

Rows = npt.NDArray[np.int64]
IsFree = Callable[[DoubleArray, DoubleArray, Rows, bool], npt.NDArray[np.bool_]]
"""Function of poses (n, 3) before and after pushes, their candidates (n,), and whether they are the first of their
sequences: true (n,) if nothing is touched."""


@dataclass(frozen=True, eq=False, slots=True)
class Sequence:
    """Sequence of candidates that ends in the goal, by predicted means.

    Attributes:
        cost: in pushes, see the module.
        reached: probability that the last push ends in the goal, if the robot plans again after each push before it.
        rows: (k,) of the candidates.
    """

    cost: float
    reached: float
    rows: Rows


@dataclass(frozen=True, eq=False, slots=True)
class Found:
    """Result of a search.

    Attributes:
        sequence: the cheapest that ends in the goal, or None.
        nearest: distance in m and turn in rad from the goal of the nearest end.
        is_complete: false if the search was stopped.
    """

    sequence: Sequence | None
    nearest: tuple[float, float]
    is_complete: bool


class _Beam(NamedTuple):
    poses: DoubleArray  # (n, 3)
    variance: DoubleArray  # (n, 2) of place and yaw
    rows: Rows  # (n, d) candidates so far


class _Ends(NamedTuple):
    """Poses after all candidates from all poses of a beam, (n * m,) each, and how far they are from the goal."""

    x: DoubleArray
    y: DoubleArray
    yaw: DoubleArray
    centres: DoubleArray  # (n * m, 2) places of the object's centre
    distance: DoubleArray
    turn: DoubleArray

    def poses(self, rows: Rows) -> DoubleArray:
        """Return some of the poses (n, 3)."""
        return np.stack([self.x[rows], self.y[rows], wrap_angles(self.yaw[rows])], axis=1)


@dataclass(frozen=True, eq=False)
class Search:
    """Search for one goal.

    Attributes:
        candidates: pushes and their motions, at least one.
        goal: region of poses.
        centre: (2,) of the object, in its frame.
        remaining_m: function of places (n, 2): how far (n,) it is for the centre to its place in the goal.
        is_free: see ``IsFree``.
        is_over: function that returns true if the search has to stop.
        width: poses of the beam.
    """

    candidates: Candidates
    goal: Region
    centre: DoubleArray
    remaining_m: Callable[[DoubleArray], DoubleArray]
    is_free: IsFree
    is_over: Callable[[], bool]
    width: int = 64

    def run(self, start: DoubleArray, most_pushes: int) -> Found:
        """Search from a pose (3,) for sequences of at most that many pushes."""
        beam = _Beam(start[None], np.zeros((1, 2)), np.zeros((1, 0), dtype=np.int64))
        cheapest: Sequence | None = None
        nearest = (np.inf, np.inf)
        for depth in range(1, most_pushes + 1):
            ends = self._ends(beam)
            nearest = min(nearest, self._nearest(ends), key=self._off)
            pause()
            finished = self._finished(beam, ends, depth)
            pause()
            if finished is not None and (cheapest is None or finished.cost < cheapest.cost):
                cheapest = finished
            # a longer sequence costs at least its pushes
            if depth == most_pushes or (cheapest is not None and cheapest.cost <= depth + 1):
                break
            if self.is_over():
                return Found(cheapest, nearest, is_complete=False)
            beam = self._next(beam, ends)
            if not len(beam.poses):
                break
            pause()
        return Found(cheapest, nearest, is_complete=True)

    def _ends(self, beam: _Beam) -> _Ends:
        motions = self.candidates.motions
        x, y = _ahead(beam.poses, motions[:, :2])
        pause()
        yaw = (beam.poses[:, 2:] + motions[:, 2]).ravel()
        centres = np.stack(_ahead(beam.poses, self._centres), axis=1)
        pause()
        goal_x, goal_y, goal_yaw = self.goal.pose
        distance = np.hypot(x - goal_x, y - goal_y)
        pause()
        return _Ends(x, y, yaw, centres, distance, np.abs(wrap_angles(yaw - goal_yaw)))

    @cached_property
    def _centres(self) -> DoubleArray:
        """Return the places (m, 2) of the object's centre after each candidate, in the object frame before it."""
        return moved(self.candidates.motions, np.append(self.centre, 0.0))[:, :2]

    @cached_property
    def _far(self) -> tuple[float, float]:
        """Return how far most candidates move the centre at most, in m, and how far they turn, in rad."""
        way_m = np.hypot(*(self._centres - self.centre).T)
        turn = np.abs(self.candidates.motions[:, 2])
        return max(float(np.quantile(way_m, _FAR)), _LEAST), max(float(np.quantile(turn, _FAR)), _LEAST)

    def _off(self, end: tuple[float, float]) -> float:
        """Return the larger of distance and turn over their tolerances."""
        return max(end[0] / self.goal.position_tolerance_m, end[1] / self.goal.angle_tolerance_rad)

    def _nearest(self, ends: _Ends) -> tuple[float, float]:
        goal = self.goal
        off = np.maximum(ends.distance / goal.position_tolerance_m, ends.turn / goal.angle_tolerance_rad)
        row = int(off.argmin())
        return float(ends.distance[row]), float(ends.turn[row])

    def _finished(self, beam: _Beam, ends: _Ends, depth: int) -> Sequence | None:
        """Return the cheapest sequence that ends in the goal with one more push and touches nothing, if any."""
        goal = self.goal
        near = np.flatnonzero((ends.distance <= goal.position_tolerance_m) & (ends.turn <= goal.angle_tolerance_rad))
        pose, last = np.divmod(near, len(self.candidates.motions))
        variance = KEPT * beam.variance[pose] + self._variance[last]
        inside = _inside(ends.distance[near], variance[:, 0], goal.position_tolerance_m)
        inside *= _inside(ends.turn[near], variance[:, 1], goal.angle_tolerance_rad)
        cost = depth + FAILURE * (1.0 - inside)
        order = np.argsort(cost, kind="stable")[:_CHECKED]
        free = self.is_free(beam.poses[pose[order]], ends.poses(near[order]), last[order], depth == 1)
        if not free.any():
            return None
        row = int(order[free][0])
        return Sequence(float(cost[row]), float(inside[row]), np.append(beam.rows[pose[row]], last[row]))

    def _next(self, beam: _Beam, ends: _Ends) -> _Beam:
        """Return the beam after one more push."""
        motions = self.candidates.motions
        far_m, far_rad = self._far
        ways = []
        for begin in range(0, len(ends.centres), _ROWS_AT_ONCE):
            ways.append(self.remaining_m(ends.centres[begin : begin + _ROWS_AT_ONCE]))
            pause()
        remaining = np.hypot(np.concatenate(ways) / far_m, ends.turn / far_rad)
        pause()
        count = min(len(remaining), _TRIED * self.width)
        near = np.argpartition(remaining, count - 1)[:count]
        pause()
        near = near[np.lexsort([near, remaining[near]])]
        units = np.array([far_m, far_m, far_rad]) * _CELL
        places = np.column_stack([ends.centres[near], ends.yaw[near]])
        cells = np.floor((places - places.min(axis=0)) / units).astype(np.int64)
        number = (cells[:, 0] * (cells[:, 1].max() + 1) + cells[:, 1]) * (cells[:, 2].max() + 1) + cells[:, 2]
        first = np.zeros(count, dtype=np.bool_)
        first[np.unique(number, return_index=True)[1]] = True
        near = np.concatenate([near[first], near[~first]])
        chosen: list[Rows] = []
        is_first = beam.rows.shape[1] == 0
        for begin in range(0, len(near), self.width):  # paths are checked until the beam is full
            part = near[begin : begin + self.width]
            pose, last = np.divmod(part, len(motions))
            chosen.append(part[self.is_free(beam.poses[pose], ends.poses(part), last, is_first)])
            if sum(map(len, chosen)) >= self.width:
                break
            pause()
        rows = np.concatenate(chosen)[: self.width]
        pose, last = np.divmod(rows, len(motions))
        variance = KEPT * beam.variance[pose] + self._variance[last]
        return _Beam(ends.poses(rows), variance, np.column_stack([beam.rows[pose], last]))

    @cached_property
    def _variance(self) -> DoubleArray:
        """Return the variances (m, 2) of place, along any direction, and yaw after each candidate."""
        square = self.candidates.std**2
        return np.stack([(square[:, 0] + square[:, 1]) / 2.0, square[:, 2]], axis=1)


def ends_of(start: DoubleArray, motions: DoubleArray) -> DoubleArray:
    """Return the poses (k + 1, 3) of an object from a pose (3,) on, that motions (k, 3) move one after the other."""
    poses = [start]
    for motion in motions:
        poses.append(moved(poses[-1], motion))
    return np.stack(poses)


def _ahead(poses: DoubleArray, places: DoubleArray) -> tuple[DoubleArray, DoubleArray]:
    """Return x and y (n * m,) in the world of places (m, 2) in the frames of poses (n, 3)."""
    cos, sin = np.cos(poses[:, 2, None]), np.sin(poses[:, 2, None])
    x, y = places.T
    return (poses[:, :1] + cos * x - sin * y).ravel(), (poses[:, 1:2] + sin * x + cos * y).ravel()


def _inside(off: DoubleArray, variance: DoubleArray, tolerance: float) -> DoubleArray:
    """Return the probability that a normal variable about ``off`` lies within a tolerance of 0."""
    std = np.sqrt(np.maximum(variance, _LEAST**2))
    return _cumulative((tolerance - off) / std) - _cumulative((-tolerance - off) / std)


def _cumulative(x: DoubleArray) -> DoubleArray:
    """Return the normal distribution function within 0.0002 (Page 1977)."""
    x = np.clip(x, -6.0, 6.0)
    found: DoubleArray = 1.0 / (1.0 + np.exp(-2.0 * np.sqrt(2.0 / np.pi) * (x + 0.044715 * x**3)))
    return found
