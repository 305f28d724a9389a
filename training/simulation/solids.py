"""Solids of Omnipush objects: convex pieces, weights and feet, from a descriptor.

An object is a square core with four sides screwed on (Bauza et al., "Omnipush", IROS 2019): side 1 faces +x, side 2
faces +y, and so on counter-clockwise. Every side is defined once, facing +x, with its inner face on the core's face.
``solid`` turns it into place. Lengths are metres, masses kilograms.

The release publishes shapes and weights but no drawing. The dimensions below are our assumption, chosen to agree with
the top-down views: a core 58 mm square, sides as wide as the core and about half as deep. The body density is that of
a printed shell with little infill.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np
import numpy.typing as npt

from service.pushing.contexts import ObjectContext, Side
from service.pushing.outlines import Outline
from training.simulation import exact

Polygon = npt.NDArray[np.float64]  # (corners, 2), convex, counter-clockwise, metres

CORE_HALF_WIDTH_M: Final = 0.029
HEIGHT_M: Final = 0.030
BODY_DENSITY_KG_M3: Final = 600.0
RECTANGLE_DEPTH_M: Final = 0.034
TRIANGLE_DEPTH_M: Final = 0.040
CIRCLE_RADIUS_M: Final = 0.029  # a half disc on the core's face, as wide as the core
CONCAVE_DEPTH_M: Final = 0.034
CONCAVE_BITE_HALF_WIDTH_M: Final = 0.025  # half width of the circular arc that is cut out of the outer face
CONCAVE_BITE_DEPTH_M: Final = 0.014
CONCAVE_SLABS: Final = 8  # convex pieces under the bite; a horn on either side makes two more
ARC_CORNERS: Final = 24  # corners of a half disc
_SEAM_M: Final = 1e-9  # a point no further out lies on the core's face

WEIGHT_RADIUS_M: Final = 0.010
WEIGHT_MASS_KG: Final = {"a": 0.0, "b": 0.060, "c": 0.150, "B": 0.060, "C": 0.150}
# Distance of a weight from the object's centre. Every side has a position near its inner face, a triangle also one at
# its tip (B and C).
INNER_WEIGHT_DISTANCE_M: Final = CORE_HALF_WIDTH_M + 0.008
OUTER_WEIGHT_DISTANCE_M: Final = CORE_HALF_WIDTH_M + 0.022

FOOT_RADIUS_M: Final = 0.002
CORE_FOOT_DISTANCE_M: Final = 0.024  # of each of the four core feet from the object's axes
SIDE_FOOT_DISTANCE_M: Final = CORE_HALF_WIDTH_M + 0.006  # of the foot under each side from the centre


@dataclass(frozen=True)
class Weight:
    """Weight: a cylinder of extra mass inside a side."""

    x_m: float
    y_m: float
    mass_kg: float


@dataclass(frozen=True)
class Solid:
    """Geometry and masses of one object in the object frame, for the simulator and for drawings."""

    pieces: tuple[Polygon, ...]
    weights: tuple[Weight, ...]
    feet_m: tuple[tuple[float, float], ...]


def concave_side() -> list[Polygon]:
    """Return a block with a circular bite out of its outer face, cut into convex slabs."""
    inner, outer = CORE_HALF_WIDTH_M, CORE_HALF_WIDTH_M + CONCAVE_DEPTH_M
    half, bite = CONCAVE_BITE_HALF_WIDTH_M, CONCAVE_BITE_DEPTH_M
    radius = (half**2 + bite**2) / (2.0 * bite)
    angles = np.linspace(-math.asin(half / radius), math.asin(half / radius), CONCAVE_SLABS + 1)
    cuts, depths = radius * exact.sin(angles), outer - bite + radius * (1.0 - exact.cos(angles))
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
    return [CIRCLE_RADIUS_M * np.stack([exact.cos(angles), exact.sin(angles)], axis=1) + (CORE_HALF_WIDTH_M, 0.0)]


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


def solid(context: ObjectContext) -> Solid:
    """Build the solid of an object: core and sides as convex pieces, weights and feet."""
    half = CORE_HALF_WIDTH_M
    pieces: list[Polygon] = [np.array([(-half, -half), (half, -half), (half, half), (-half, half)])]
    weights: list[Weight] = []
    foot = CORE_FOOT_DISTANCE_M
    feet = [(foot, foot), (-foot, foot), (-foot, -foot), (foot, -foot)]
    for quarter_turns, side in enumerate(context.sides):
        turn = _quarter_turn(quarter_turns)
        pieces += [piece @ turn.T for piece in SIDE_SHAPES[side.shape]()]
        feet.append(_point(turn, SIDE_FOOT_DISTANCE_M))
        if WEIGHT_MASS_KG[side.weight] > 0.0:
            x_m, y_m = _point(turn, _weight_distance_m(side))
            weights.append(Weight(x_m, y_m, WEIGHT_MASS_KG[side.weight]))
    return Solid(tuple(pieces), tuple(weights), tuple(feet))


def outline(context: ObjectContext) -> Outline:
    """Build the outline of an object: from corner to corner of the core, around the pieces of each side."""
    corner = (CORE_HALF_WIDTH_M, -CORE_HALF_WIDTH_M)
    parts = []
    for quarter_turns, side in enumerate(context.sides):
        points = np.unique(np.concatenate(SIDE_SHAPES[side.shape]()), axis=0)
        outer = points[points[:, 0] > CORE_HALF_WIDTH_M + _SEAM_M]
        around = np.array([corner, *outer[np.argsort(outer[:, 1], kind="stable")]])
        parts.append(around @ _quarter_turn(quarter_turns).T)
    return Outline.of(np.concatenate(parts))


def centre_of_mass_m(context: ObjectContext) -> npt.NDArray[np.float64]:
    """Compute the centre of mass (2,) of an object in its frame: of the body and the weights."""
    body = outline(context)
    mass_kg = body.area_m2 * HEIGHT_M * BODY_DENSITY_KG_M3
    moment = mass_kg * body.centroid_m
    for weight in solid(context).weights:
        mass_kg += weight.mass_kg
        moment = moment + weight.mass_kg * np.array([weight.x_m, weight.y_m])
    return np.asarray(moment / mass_kg)


def clearance_m(piece: Polygon, points: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Compute the signed distance of points (n, 2) from a convex piece in metres, (n,), negative inside.

    Outside it is the distance to the nearest edge, inside the depth below the line of the nearest edge.
    """
    start, end = piece, np.roll(piece, -1, axis=0)
    edge = end - start  # (corners, 2)
    offset = points[:, None, :] - start  # (n, corners, 2)
    along = np.clip((offset * edge).sum(-1) / (edge * edge).sum(-1), 0.0, 1.0)
    distance = np.linalg.norm(offset - along[..., None] * edge, axis=-1).min(axis=1)
    inside = (edge[:, 0] * offset[..., 1] - edge[:, 1] * offset[..., 0] >= 0.0).all(axis=1)
    signed: npt.NDArray[np.float64] = np.where(inside, -distance, distance)
    return signed


def _weight_distance_m(side: Side) -> float:
    return OUTER_WEIGHT_DISTANCE_M if side.weight in ("B", "C") else INNER_WEIGHT_DISTANCE_M


def _quarter_turn(count: int) -> npt.NDArray[np.float64]:
    """Return an exact rotation matrix by a multiple of 90 degrees."""
    cosine, sine = ((1, 0), (0, 1), (-1, 0), (0, -1))[count % 4]
    return np.array([[cosine, -sine], [sine, cosine]], dtype=np.float64)


def _point(turn: npt.NDArray[np.float64], distance_m: float) -> tuple[float, float]:
    x_m, y_m = turn @ np.array([distance_m, 0.0])
    return float(x_m), float(y_m)
