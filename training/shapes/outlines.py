"""Random outlines of a family, in metres: proportions from the family, then size, orientation, and origin.

The size is the largest distance between two corners, 20 to 300 mm, even in its logarithm. The orientation is any. The
origin lies off the centroid by up to a tenth of the size along each axis, as a tracker's markers do: outlines come in
any frame, and a model that takes the origin for the centroid fails here first.

Corners are on a grid of a micrometre, so that last digits, which depend on the processor, vanish.
"""

import math
from typing import Final

import numpy as np
import shapely
from shapely import Polygon

from service.pushing.outlines import Outline
from training.shapes.families import FAMILIES
from training.shapes.pieces import between, log_between

SIZES_M: Final = (0.020, 0.300)
LEAST_WIDTH_M: Final = 0.003  # an object is somewhere as wide as this: a bar of 300 mm may be thin, one of 20 mm not
ORIGIN_SHARE: Final = 0.1
TOLERANCES_M: Final = (0.0001, 0.0003)  # of the corners that are left out, a five-hundredth of the size between these
GRID_M: Final = 1e-6


def draw_outline(family: str, rng: np.random.Generator) -> Outline:
    """Draw an outline of a family of ``FAMILIES``, in metres. The same generator gives the same corners."""
    while True:
        shape = FAMILIES[family](rng)
        size_m = log_between(rng, *SIZES_M)
        turn_rad = between(rng, -math.pi, math.pi)
        offset = between(rng, -ORIGIN_SHARE, ORIGIN_SHARE), between(rng, -ORIGIN_SHARE, ORIGIN_SHARE)
        placed = _placed(shape, size_m, turn_rad, (offset[0] * size_m, offset[1] * size_m))
        low, high = TOLERANCES_M
        plain = placed.simplify(min(max(low, size_m / 500.0), high))
        if not plain.buffer(-LEAST_WIDTH_M / 2.0).is_empty and plain.is_valid:
            return Outline.of(shapely.get_coordinates(plain)[:-1])


def _placed(shape: Polygon, size_m: float, turn_rad: float, offset_m: tuple[float, float]) -> Polygon:
    """Return a shape in metres, turned about its centroid, which is moved to an offset, on the grid."""
    corners = shapely.get_coordinates(shape)
    x, y = shapely.get_coordinates(shape.convex_hull).T
    scale = size_m / math.sqrt(float(((x[:, None] - x) ** 2 + (y[:, None] - y) ** 2).max()))
    x, y = scale * (corners - (shape.centroid.x, shape.centroid.y)).T
    cos, sin = math.cos(turn_rad), math.sin(turn_rad)
    placed = np.column_stack([cos * x - sin * y + offset_m[0], sin * x + cos * y + offset_m[1]])
    return Polygon(np.round(placed / GRID_M) * GRID_M)
