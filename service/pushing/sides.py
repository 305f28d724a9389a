"""Sides of Omnipush objects: polygons of the core and of the four shapes of side, and the outline that they make.

An object is a square core with four sides screwed on (Bauza et al., "Omnipush", IROS 2019): side 1 faces +x, side 2
faces +y, and so on counter-clockwise. Every side is defined once, facing +x, with its inner face on the core's face.

The release publishes shapes but no drawing. The dimensions below are our assumption, chosen to agree with the top-down
views: a core 58 mm square, sides as wide as the core and about half as deep. Sines are those of the C library, so that
every processor computes the same bytes. numpy only.
"""

import math
from collections.abc import Callable
from functools import lru_cache
from itertools import pairwise
from typing import Final

import numpy as np
import numpy.typing as npt

from service.pushing.contexts import SIDES, ObjectContext
from service.pushing.outlines import Outline

Polygon = npt.NDArray[np.float64]  # (corners, 2), convex, counter-clockwise, metres

CORE_HALF_WIDTH_M: Final = 0.029
RECTANGLE_DEPTH_M: Final = 0.034
TRIANGLE_DEPTH_M: Final = 0.040
CIRCLE_RADIUS_M: Final = 0.029  # a half disc on the core's face, as wide as the core
CONCAVE_DEPTH_M: Final = 0.034
CONCAVE_BITE_HALF_WIDTH_M: Final = 0.025  # half width of the circular arc that is cut out of the outer face
CONCAVE_BITE_DEPTH_M: Final = 0.014
CONCAVE_SLABS: Final = 8  # convex pieces under the bite; a horn on either side makes two more
ARC_CORNERS: Final = 24  # corners of a half disc
_SEAM_M: Final = 1e-9  # a point no further out lies on the core's face


def concave_side() -> list[Polygon]:
    """Return a block with a circular bite out of its outer face, cut into convex slabs."""
    inner, outer = CORE_HALF_WIDTH_M, CORE_HALF_WIDTH_M + CONCAVE_DEPTH_M
    half, bite = CONCAVE_BITE_HALF_WIDTH_M, CONCAVE_BITE_DEPTH_M
    radius = (half**2 + bite**2) / (2.0 * bite)
    angles = np.linspace(-math.asin(half / radius), math.asin(half / radius), CONCAVE_SLABS + 1)
    cuts, depths = radius * _sines(angles), outer - bite + radius * (1.0 - _cosines(angles))
    horn = [(-CORE_HALF_WIDTH_M, outer), *zip(cuts, depths, strict=True), (CORE_HALF_WIDTH_M, outer)]
    return [
        np.array([(inner, low), (x_low, low), (x_high, high), (inner, high)])
        for (low, x_low), (high, x_high) in pairwise(horn)
    ]


def triangular_side() -> list[Polygon]:
    """Return a triangle on the core's face, with its tip outwards."""
    inner, half = CORE_HALF_WIDTH_M, CORE_HALF_WIDTH_M
    return [np.array([(inner, -half), (inner + TRIANGLE_DEPTH_M, 0.0), (inner, half)])]


def circular_side() -> list[Polygon]:
    """Return a half disc on the core's face."""
    angles = np.linspace(-math.pi / 2, math.pi / 2, ARC_CORNERS)
    return [CIRCLE_RADIUS_M * np.stack([_cosines(angles), _sines(angles)], axis=1) + (CORE_HALF_WIDTH_M, 0.0)]


def rectangular_side() -> list[Polygon]:
    """Return a plain block."""
    inner, outer, half = CORE_HALF_WIDTH_M, CORE_HALF_WIDTH_M + RECTANGLE_DEPTH_M, CORE_HALF_WIDTH_M
    return [np.array([(inner, -half), (outer, -half), (outer, half), (inner, half)])]


SIDE_SHAPES: Final[dict[str, Callable[[], list[Polygon]]]] = {
    "1": concave_side,
    "2": triangular_side,
    "3": circular_side,
    "4": rectangular_side,
}


def outline(context: ObjectContext) -> Outline:
    """Build the outline of an object: from corner to corner of the core, around the pieces of each side."""
    return outline_of_shapes("".join(side.shape for side in context.sides))


def outline_of_shapes(digits: str) -> Outline:
    """Build the outline of an object from the shape digits of its sides. Weights do not change it."""
    corners = np.concatenate([_part(digit, quarter_turns) for quarter_turns, digit in enumerate(digits)])
    corners.setflags(write=False)
    return Outline(corners)  # counter-clockwise and simple by construction


@lru_cache(maxsize=len(SIDE_SHAPES) * SIDES)
def _part(digit: str, quarter_turns: int) -> Polygon:
    """Return the corners of a side in its place, the core's corner before it included."""
    points = np.unique(np.concatenate(SIDE_SHAPES[digit]()), axis=0)
    outer = points[points[:, 0] > CORE_HALF_WIDTH_M + _SEAM_M]
    around = np.array([(CORE_HALF_WIDTH_M, -CORE_HALF_WIDTH_M), *outer[np.argsort(outer[:, 1], kind="stable")]])
    return around @ quarter_turn(quarter_turns).T


def quarter_turn(count: int) -> npt.NDArray[np.float64]:
    """Return an exact rotation matrix by a multiple of 90 degrees."""
    cosine, sine = ((1, 0), (0, 1), (-1, 0), (0, -1))[count % 4]
    return np.array([[cosine, -sine], [sine, cosine]], dtype=np.float64)


def _sines(angles_rad: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    return np.array([math.sin(angle) for angle in angles_rad])


def _cosines(angles_rad: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    return np.array([math.cos(angle) for angle in angles_rad])
