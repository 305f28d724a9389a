"""Outlines: objects of any shape as simple polygons in metres, validated once, with the geometry of pushing.

The frame is the caller's: any origin and any orientation. Corners are stored counter-clockwise. Distances compare every
point with every edge, in chunks of bounded memory. Only additions, products, divisions and square roots are used, so
that every processor computes the same bytes. numpy only.
"""

from collections.abc import Iterator, Sized
from dataclasses import dataclass
from functools import cached_property
from typing import Final, Self

import numpy as np
import numpy.typing as npt

from service.errors import InvalidRequestError
from service.pushing.poses import WORLD_M, DoubleArray

FEWEST_CORNERS: Final = 3
MOST_CORNERS: Final = 512
SMALLEST_EXTENT_M: Final = 0.005
LARGEST_EXTENT_M: Final = 2.0
MOST_SAMPLES: Final = 1_000_000  # cells of a grid
_CORNERS: Final = "3 to 512 corners [x, y] in metres, in order around the outline"
_TOUCH: Final = 1e-9  # of the extent: an edge that comes this near to another one touches it
_THIN: Final = 1e-6  # of the extent: a polygon no wider than this has no area
_CHUNK_PAIRS: Final = 1 << 15  # pairs of a point and an edge at a time, which stay in the cache of a processor


@dataclass(frozen=True, eq=False)
class Nearest:
    """The nearest places of a boundary to n points."""

    point_m: DoubleArray
    """(n, 2) on the boundary."""
    normal: DoubleArray
    """(n, 2) unit vectors along the line from point to boundary, which point into the object.

    At a corner, they turn with the point. On the boundary itself, they are those of the edge.
    """
    distance_m: DoubleArray
    """(n,) of the points from the boundary, negative inside."""


@dataclass(frozen=True, eq=False)
class Outline:
    """The outline of an object: a simple polygon. ``of`` validates it, and its arrays are read-only."""

    corners: DoubleArray
    """(n, 2) m, counter-clockwise, without a repeated last corner."""

    @classmethod
    def of(
        cls,
        corners: npt.ArrayLike,
        where: str = "outline",
        extents_m: tuple[float, float] = (SMALLEST_EXTENT_M, LARGEST_EXTENT_M),
    ) -> Self:
        """Create an outline from corners (n, 2) in metres, clockwise or counter-clockwise.

        Args:
            corners: of the polygon.
            where: field that has them, for errors.
            extents_m: least and largest distance of its two most distant corners.

        Raises:
            InvalidRequestError: there are fewer than 3 or more than 512 corners, a value is not finite, a corner is
                repeated, edges cross or touch, there is no area, or the extent is outside of its limits. Names the
                field, the corner or the edges, and the cure.
        """
        found = _checked_corners(corners, where)
        distance = _squares(found[:, None, :] - found[None, :, :])
        extent_m = float(np.sqrt(distance.max()))
        _check_extent(extent_m, extents_m, where)
        _check_repeats(distance, extent_m, where)
        _check_area(found, where)
        _check_crossings(found, extent_m, where)
        if _area_m2(found) < 0.0:
            found = found[::-1].copy()
        found.setflags(write=False)
        return cls(found)

    @cached_property
    def edges(self) -> DoubleArray:
        """Return the edge vectors (n, 2) m. Edge i leads from corner i to the next one."""
        edges: DoubleArray = np.roll(self.corners, -1, axis=0) - self.corners
        edges.setflags(write=False)
        return edges

    @cached_property
    def _inward(self) -> DoubleArray:
        """Return the unit normals (n, 2) of the edges that point into the object."""
        edges = self.edges
        return np.stack([-edges[:, 1], edges[:, 0]], axis=1) / np.sqrt(_squares(edges))[:, None]

    @cached_property
    def area_m2(self) -> float:
        """Return the area."""
        return _area_m2(self.corners)

    @cached_property
    def centroid_m(self) -> DoubleArray:
        """Return the centroid (2,) of the area."""
        start, end, cross = self._fan(self.corners[0])
        centroid: DoubleArray = self.corners[0] + ((start + end) * cross[:, None]).sum(axis=0) / (3.0 * cross.sum())
        centroid.setflags(write=False)
        return centroid

    @cached_property
    def size_m(self) -> float:
        """Return the root mean square distance of the area from its centroid."""
        start, end, cross = self._fan(self.centroid_m)
        squares = (start**2 + start * end + end**2).sum(axis=1)
        return float(np.sqrt((squares * cross).sum() / (6.0 * cross.sum())))

    @cached_property
    def extent_m(self) -> float:
        """Return the largest distance between two corners."""
        return _extent_m(self.corners)

    @cached_property
    def perimeter_m(self) -> float:
        """Return the length of the boundary."""
        return float(np.sqrt(_squares(self.edges)).sum())

    def along(self, shares: DoubleArray) -> tuple[DoubleArray, DoubleArray]:
        """Return points (n, 2) and inward normals (n, 2) at shares (n,) of the way around, from the first corner on."""
        lengths = np.sqrt(_squares(self.edges))
        ends = np.cumsum(lengths)
        place = (shares % 1.0) * ends[-1]
        edge = np.minimum(np.searchsorted(ends, place, side="right"), len(ends) - 1)
        part = (place - ends[edge]) / lengths[edge] + 1.0
        return self.corners[edge] + part[:, None] * self.edges[edge], self._inward[edge]

    def contains(self, points: DoubleArray) -> npt.NDArray[np.bool_]:
        """Return (n,) true for the points (n, 2) inside. A point on the boundary may count as either."""
        points = np.asarray(points, dtype=np.float64)
        inside = np.empty(len(points), dtype=np.bool_)
        start, end = self.corners, np.roll(self.corners, -1, axis=0)
        for rows in self._chunks(len(points)):
            x, y = points[rows, 0, None], points[rows, 1, None]
            spans = (start[:, 1] <= y) != (end[:, 1] <= y)
            left = (end[:, 0] - start[:, 0]) * (y - start[:, 1]) - (x - start[:, 0]) * (end[:, 1] - start[:, 1])
            inside[rows] = (spans & ((left > 0.0) == (end[:, 1] > start[:, 1]))).sum(axis=1) % 2 == 1
        return inside

    def nearest(self, points: DoubleArray) -> "Nearest":
        """Return the nearest places of the boundary to points (n, 2)."""
        points = np.asarray(points, dtype=np.float64)
        edge, share = np.empty(len(points), dtype=np.int64), np.empty(len(points))
        for rows in self._chunks(len(points)):
            squares, shares = _to_edges(points[rows], self.corners, self.edges)
            edge[rows] = squares.argmin(axis=1)
            share[rows] = shares[np.arange(len(shares)), edge[rows]]
        found = self.corners[edge] + share[:, None] * self.edges[edge]
        inward = self._inward[edge]
        # At a corner, the sum of the normals of both edges tells on which side a point is (Baerentzen, Aanaes 2005).
        beside = np.where(share == 0.0, edge - 1, np.where(share == 1.0, (edge + 1) % len(self.corners), edge))
        offset = found - points
        length = np.sqrt(_squares(offset))
        outside = (offset * (inward + self._inward[beside])).sum(axis=1) >= 0.0
        distance = np.where(outside, length, -length)
        clear = length > _TOUCH * self.extent_m
        normal = np.where(clear[:, None], offset / np.where(clear, distance, 1.0)[:, None], inward)
        return Nearest(found, normal, distance)

    def distance_m(self, points: DoubleArray) -> DoubleArray:
        """Return the distance (n,) of points (n, 2) from the boundary, negative inside."""
        return self.nearest(points).distance_m

    def samples(self, spacing_m: float) -> DoubleArray:
        """Return the points (k, 2) inside of an even grid along the axes, symmetric about the middle of the box.

        Raises:
            ValueError: the grid has more than a million points.
        """
        low, high = self.corners.min(axis=0), self.corners.max(axis=0)
        counts = np.ceil((high - low) / spacing_m)
        if not 0.0 < counts.prod() <= MOST_SAMPLES:
            raise ValueError(f"a spacing of {spacing_m:g} m for an outline of {self.extent_m:g} m; use a wider one")
        x, y = (
            (low[axis] + high[axis]) / 2.0 + (np.arange(counts[axis]) - (counts[axis] - 1.0) / 2.0) * spacing_m
            for axis in (0, 1)
        )
        grid = np.stack([np.tile(x, len(y)), np.repeat(y, len(x))], axis=1)
        return grid[self.contains(grid)]

    def _fan(self, about: DoubleArray) -> tuple[DoubleArray, DoubleArray, DoubleArray]:
        """Return both ends (n, 2) of the edges, seen from a point, and twice the signed area (n,) that they span."""
        start = self.corners - about
        end = np.roll(start, -1, axis=0)
        return start, end, start[:, 0] * end[:, 1] - start[:, 1] * end[:, 0]

    def _chunks(self, points: int) -> Iterator[slice]:
        rows = max(1, _CHUNK_PAIRS // len(self.corners))
        return (slice(first, first + rows) for first in range(0, points, rows))


def _checked_corners(corners: npt.ArrayLike, where: str) -> DoubleArray:
    """Return corners as float64 (n, 2), if they are numbers in that form."""
    count = len(corners) if isinstance(corners, Sized) else 0
    if not FEWEST_CORNERS <= count <= MOST_CORNERS:
        raise InvalidRequestError.at(where, f"{count} corners", _CORNERS)
    try:
        found = np.array(corners)
    except ValueError:  # rows of different lengths
        found = np.array(None)
    if found.ndim != 2 or found.shape[1] != 2 or found.dtype.kind not in "iuf":
        raise InvalidRequestError.at(where, "corners that are not pairs of numbers", _CORNERS)
    found = found.astype(np.float64)
    faulty = ~(np.abs(found) <= WORLD_M).all(axis=1)  # not finite, or out of this world
    if faulty.any():
        corner = int(faulty.argmax())
        received = f"[{found[corner, 0]:g}, {found[corner, 1]:g}]"
        raise InvalidRequestError.at(
            f"{where}.{corner}", received, f"finite numbers within {WORLD_M:g} m of the origin"
        )
    return found


def _check_extent(extent_m: float, extents_m: tuple[float, float], where: str) -> None:
    least_m, most_m = extents_m
    if not least_m <= extent_m <= most_m:
        unit = "; are these millimetres?" if extent_m > most_m else ""
        received = f"an object of {extent_m:.4g} m across{unit}"
        raise InvalidRequestError.at(where, received, f"{least_m:g} to {most_m:g} m, in metres")


def _check_repeats(distance: DoubleArray, extent_m: float, where: str) -> None:
    """Refuse equal corners, wherever they stand, by the squared distances (n, n) of all corners."""
    np.fill_diagonal(distance, np.inf)
    first, second = (int(index) for index in np.unravel_index(distance.argmin(), distance.shape))
    if distance[first, second] <= (_TOUCH * extent_m) ** 2:
        closed = first == 0 and second == len(distance) - 1
        accepted = "an outline without its first corner again at the end" if closed else "each corner once"
        raise InvalidRequestError.at(f"{where}.{second}", f"the same point as corner {first}", accepted)


def _check_area(corners: DoubleArray, where: str) -> None:
    """Refuse corners that all lie on one line."""
    far = int(_squares(corners - corners[0]).argmax())
    across = np.abs(_sides(corners[:1], corners[far : far + 1], corners))
    if across.max() <= _THIN * _squares(corners[far] - corners[0]):
        raise InvalidRequestError.at(where, "corners on one line, without area", "a polygon around the object")


def _check_crossings(corners: DoubleArray, extent_m: float, where: str) -> None:
    """Refuse edges that cross, overlap or touch other edges than their neighbours."""
    count = len(corners)
    start, end = corners, np.roll(corners, -1, axis=0)
    squares, _ = _to_edges(corners, corners, end - start)  # (corner, edge)
    touch = squares <= (_TOUCH * extent_m) ** 2
    index = np.arange(count)
    touch[index, index] = touch[index, index - 1] = False  # the two edges that meet in the corner
    side_start, side_end = (_sides(start, end, point) for point in (start, end))  # (edge, edge)
    apart = side_start * side_end < 0.0
    crossing = (apart & apart.T) | touch
    if crossing.any():
        first, second = sorted(int(index) for index in np.argwhere(crossing)[0])
        accepted = "a simple polygon: corners in order around the outline, edges that only meet at their own corners"
        received = f"edges {first} and {second} that cross or touch (edge i leads from corner i to the next)"
        raise InvalidRequestError.at(where, received, accepted)


def _sides(start: DoubleArray, end: DoubleArray, points: DoubleArray) -> DoubleArray:
    """Return (edge, point) positive where a point is on the left of an edge."""
    along, offset = (end - start)[:, None, :], points[None, :, :] - start[:, None, :]
    return along[..., 0] * offset[..., 1] - along[..., 1] * offset[..., 0]


def _to_edges(points: DoubleArray, starts: DoubleArray, edges: DoubleArray) -> tuple[DoubleArray, DoubleArray]:
    """Return the squared distances (n, edges) of points (n, 2) from edges, and where along each edge, in [0, 1]."""
    x, y = points[:, 0, None] - starts[:, 0], points[:, 1, None] - starts[:, 1]
    share = np.clip((x * edges[:, 0] + y * edges[:, 1]) / _squares(edges), 0.0, 1.0)
    x -= share * edges[:, 0]
    y -= share * edges[:, 1]
    return x * x + y * y, share


def _squares(vectors: DoubleArray) -> DoubleArray:
    """Return the squared lengths of vectors along the last axis."""
    return vectors[..., 0] ** 2 + vectors[..., 1] ** 2


def _extent_m(corners: DoubleArray) -> float:
    return float(np.sqrt(_squares(corners[:, None, :] - corners[None, :, :]).max()))


def _area_m2(corners: DoubleArray) -> float:
    """Return the area, negative for clockwise corners."""
    x, y = (corners - corners[0]).T
    return float((x * np.roll(y, -1) - np.roll(x, -1) * y).sum()) / 2.0
