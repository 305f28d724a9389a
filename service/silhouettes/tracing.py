"""Tracing: from a plane of coverage to the outer boundaries of its regions, as simple polygons of few corners."""

import heapq
from dataclasses import dataclass
from typing import Final, cast

import numpy as np
import numpy.typing as npt
from contourpy import LineType, contour_generator

from service.pushing.poses import DoubleArray

LEVEL: Final = 0.5  # of coverage, where an object ends
_Lines = tuple[list[DoubleArray | None], list[npt.NDArray[np.uint32] | None]]  # points of one chunk, and their loops


@dataclass(frozen=True, eq=False)
class Region:
    """Region of a plane, without its holes.

    Attributes:
        boundary: (n, 2) corners x, y in pixels from the upper left corner of the plane, x right, y down.
        area: that it encloses, in pixels.
    """

    boundary: DoubleArray
    area: float


def regions(plane: npt.NDArray[np.float32], most: int = 8) -> list[Region]:
    """Return the largest regions above ``LEVEL``, the largest first.

    Pixels have their values in their middles, and values between them are linear (marching squares). A region at the
    border of the plane ends there.
    """
    rows, columns = plane.shape
    framed = np.zeros((rows + 2, columns + 2), dtype=np.float32)
    framed[1:-1, 1:-1] = plane
    lines = contour_generator(z=framed, line_type=LineType.ChunkCombinedOffset).lines(LEVEL)
    (points,), (offsets,) = cast(_Lines, lines)
    if points is None or offsets is None:
        return []
    starts = offsets.astype(np.int64)
    areas = _loop_areas(points, starts)
    found = []
    for loop in np.argsort(-areas)[:most]:
        if areas[loop] <= 0.0:  # holes are wound the other way
            break
        boundary = np.clip(points[starts[loop] : starts[loop + 1] - 1] - 0.5, 0.0, (columns, rows))
        found.append(Region(boundary, float(areas[loop])))
    return found


def _loop_areas(points: DoubleArray, starts: npt.NDArray[np.int64]) -> DoubleArray:
    """Return the areas of closed loops, negative for holes. Each loop repeats its first point at its end."""
    cross = points[:-1, 0] * points[1:, 1] - points[1:, 0] * points[:-1, 1]
    cross[starts[1:-1] - 1] = 0.0  # between loops
    areas = np.add.reduceat(cross, starts[:-1]) / 2.0
    return np.asarray(areas, dtype=np.float64)


def simplified(boundary: DoubleArray, most: int, tolerance: float) -> DoubleArray:
    """Return the corners of a closed boundary (n, 2) that matter, at most ``most`` of them.

    Corner after corner is added where the boundary is farthest from the polygon so far, until it is nowhere farther
    than the tolerance (Ramer 1972; Douglas, Peucker 1973).
    """
    count = len(boundary)
    first = int(((boundary - boundary.mean(axis=0)) ** 2).sum(axis=1).argmax())
    loop = np.concatenate([np.roll(boundary, -first, axis=0), boundary[first : first + 1]])
    opposite = int(((loop - loop[0]) ** 2).sum(axis=1).argmax())
    kept = {0, opposite}
    gaps = [_farthest(loop, 0, opposite), _farthest(loop, opposite, count)]
    heapq.heapify(gaps)
    while gaps and len(kept) < most:
        distance, at, start, end = heapq.heappop(gaps)
        if -distance <= tolerance and (len(kept) > 2 or distance == 0.0):
            break
        kept.add(at)
        for part in (_farthest(loop, start, at), _farthest(loop, at, end)):
            heapq.heappush(gaps, part)
    return loop[sorted(kept)]


def _farthest(loop: DoubleArray, start: int, end: int) -> tuple[float, int, int, int]:
    """Return the negative distance of the point between two that is farthest from their segment, and its place."""
    if end - start < 2:
        return 0.0, start, start, end
    along = loop[end] - loop[start]
    offset = loop[start + 1 : end] - loop[start]
    share = np.clip(offset @ along / max(float(along @ along), 1e-12), 0.0, 1.0)
    squares = ((offset - share[:, None] * along) ** 2).sum(axis=1)
    at = int(squares.argmax())
    return -(float(squares[at]) ** 0.5), start + 1 + at, start, end
