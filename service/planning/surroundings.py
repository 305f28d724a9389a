"""Surroundings of a planned push: a workspace and obstacles, as the distance of places in the world from both.

Distances are stored on a grid of bounded size. The distance of a place from the nearest cell bounds how wrong its value
is, because distances change by no more than one moves. Only places within that bound of a limit are compared with the
polygons themselves, so answers are exact.

``Wave`` is how far it is to the goal around the obstacles, for a point as wide as the object at its narrowest: it
guides a search, and no answer depends on its precision. numpy only.
"""

from dataclasses import dataclass, field
from functools import cached_property
from typing import Final

import numpy as np
import numpy.typing as npt

from service.pushing.outlines import Outline
from service.pushing.poses import DoubleArray
from service.turns import pause

CELLS: Final = 128  # of the grid along its longer side
_PADDING: Final = 0.05  # of the box around places, on each side
_ROWS_AT_ONCE: Final = 1024  # points between two pauses
_MOST_TURNS: Final = 4 * CELLS  # of a wave: ways of a few turns around obstacles are no longer
_DIAGONAL: Final = 2.0**0.5
_NEIGHBOURS: Final = [(dx, dy) for dx in (-1, 0, 1) for dy in (-1, 0, 1) if (dx, dy) != (0, 0)]


@dataclass(frozen=True, eq=False)
class Surroundings:
    """Workspace and obstacles in the world. Without both, every place is free.

    Attributes:
        workspace: in which object and tip stay, or None.
        obstacles: that neither touches.
        around: (n, 2) places that the grid has to cover: those of start and goal.
    """

    workspace: Outline | None
    obstacles: tuple[Outline, ...]
    around: DoubleArray = field(default_factory=lambda: np.zeros((1, 2)))

    @property
    def is_empty(self) -> bool:
        """Return True if every place is free."""
        return self.workspace is None and not self.obstacles

    def distance_m(self, points: DoubleArray) -> DoubleArray:
        """Return the distance (n,) of points (n, 2) from what is forbidden, negative inside of it."""
        found = np.full(len(points), np.inf)
        for first in range(0, len(points), _ROWS_AT_ONCE):
            part = slice(first, first + _ROWS_AT_ONCE)
            for obstacle in self.obstacles:
                found[part] = np.minimum(found[part], obstacle.distance_m(points[part]))
            if self.workspace is not None:
                found[part] = np.minimum(found[part], -self.workspace.distance_m(points[part]))
            pause()
        return found

    def keeps(self, points: DoubleArray, least_m: npt.ArrayLike) -> npt.NDArray[np.bool_]:
        """Return (n,) true for points (n, 2) at least so far, one for all or (n,), from what is forbidden."""
        if self.is_empty:
            return np.ones(len(points), dtype=np.bool_)
        near, apart = self.grid.nearest(points)
        least = np.broadcast_to(np.asarray(least_m, dtype=np.float64), len(points))
        kept: npt.NDArray[np.bool_] = near - apart >= least
        doubtful = np.flatnonzero(~kept & (near + apart >= least))
        kept[doubtful] = self.distance_m(points[doubtful]) >= least[doubtful]
        return kept

    @cached_property
    def grid(self) -> "Grid":
        """Return the distances on a grid."""
        shown = [self.around, *(obstacle.corners for obstacle in self.obstacles)]
        if self.workspace is not None:
            shown = [self.workspace.corners]
        places = np.concatenate(shown)
        low, high = places.min(axis=0), places.max(axis=0)
        size = float((high - low).max())
        low, high = low - _PADDING * size, high + _PADDING * size
        cell_m = float((high - low).max()) / CELLS
        counts = np.maximum(np.ceil((high - low) / cell_m).astype(np.int64), 1)
        x, y = (low[axis] + (np.arange(counts[axis]) + 0.5) * cell_m for axis in (0, 1))
        centres = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1)
        values = self.distance_m(centres.reshape(-1, 2)).reshape(tuple(counts))
        return Grid(low, cell_m, values)


@dataclass(frozen=True, eq=False, slots=True)
class Grid:
    """Values of the cells of a grid.

    Attributes:
        low: (2,) corner of the first cell.
        cell_m: side of a cell.
        values: (i, j) at the middle of each cell, along x and y.
    """

    low: DoubleArray
    cell_m: float
    values: DoubleArray

    def cells(self, points: DoubleArray) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
        """Return the nearest cells of points (n, 2)."""
        last = np.array(self.values.shape) - 1
        found = np.clip(np.floor((points - self.low) / self.cell_m), 0, last).astype(np.int64)
        return found[:, 0], found[:, 1]

    def halved(self) -> "Grid":
        """Return every second cell along both axes as a cell twice as wide."""
        return Grid(self.low - self.cell_m / 2.0, 2.0 * self.cell_m, self.values[::2, ::2])

    def nearest(self, points: DoubleArray) -> tuple[DoubleArray, DoubleArray]:
        """Return the values (n,) of the nearest cells of points (n, 2), and how far (n,) their middles are."""
        i, j = self.cells(points)
        x, y = self.low[0] + (i + 0.5) * self.cell_m, self.low[1] + (j + 0.5) * self.cell_m
        return self.values[i, j], np.hypot(points[:, 0] - x, points[:, 1] - y)


@dataclass(frozen=True, eq=False, slots=True)
class Wave:
    """Distances to a goal around obstacles, on the cells of a grid."""

    goal: DoubleArray
    grid: Grid

    @classmethod
    def around(cls, surroundings: Surroundings, goal: DoubleArray, width_m: float) -> "Wave":
        """Spread from the goal (2,) over all cells that are at least a width from what is forbidden.

        Cells that the wave does not reach are as far as the whole grid is long.
        """
        grid = surroundings.grid.halved()
        free = grid.values >= width_m
        i, j = (int(place[0]) for place in grid.cells(goal[None]))
        free[i, j] = True
        far = float(free.size) * grid.cell_m
        found = np.full((free.shape[0] + 2, free.shape[1] + 2), far)
        found[i + 1, j + 1] = 0.0
        steps = [(dx, dy, grid.cell_m * (_DIAGONAL if dx and dy else 1.0)) for dx, dy in _NEIGHBOURS]
        inner = found[1:-1, 1:-1]
        for turn in range(_MOST_TURNS):
            before = inner.copy()
            for dx, dy, step in steps:
                shifted = found[1 + dx : found.shape[0] - 1 + dx, 1 + dy : found.shape[1] - 1 + dy]
                np.minimum(inner, np.where(free, shifted + step, far), out=inner)
            if np.array_equal(before, inner):
                break
            if turn % 16 == 0:
                pause()
        return cls(goal, Grid(grid.low, grid.cell_m, inner.copy()))

    def distance_m(self, points: DoubleArray) -> DoubleArray:
        """Return how far (n,) it is from points (n, 2) to the goal: at least the straight way."""
        i, j = self.grid.cells(points)
        straight = np.hypot(points[:, 0] - self.goal[0], points[:, 1] - self.goal[1])
        found: DoubleArray = np.maximum(self.grid.values[i, j] - _DIAGONAL * self.grid.cell_m, straight)
        return found
