"""Solids of Omnipush objects: convex pieces, weights and feet, from a descriptor.

The core and its sides are those of ``service.pushing.sides``, and ``solid`` turns every side into place. Lengths are
metres, masses kilograms. The density of the body is our assumption: that of a printed shell with little infill.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from service.pushing.contexts import ObjectContext, Side
from service.pushing.sides import CORE_HALF_WIDTH_M, SIDE_SHAPES, Polygon, outline, quarter_turn

HEIGHT_M: Final = 0.030
BODY_DENSITY_KG_M3: Final = 600.0

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


def solid(context: ObjectContext) -> Solid:
    """Build the solid of an object: core and sides as convex pieces, weights and feet."""
    half = CORE_HALF_WIDTH_M
    pieces: list[Polygon] = [np.array([(-half, -half), (half, -half), (half, half), (-half, half)])]
    weights: list[Weight] = []
    foot = CORE_FOOT_DISTANCE_M
    feet = [(foot, foot), (-foot, foot), (-foot, -foot), (foot, -foot)]
    for quarter_turns, side in enumerate(context.sides):
        turn = quarter_turn(quarter_turns)
        pieces += [piece @ turn.T for piece in SIDE_SHAPES[side.shape]()]
        feet.append(_point(turn, SIDE_FOOT_DISTANCE_M))
        if WEIGHT_MASS_KG[side.weight] > 0.0:
            x_m, y_m = _point(turn, _weight_distance_m(side))
            weights.append(Weight(x_m, y_m, WEIGHT_MASS_KG[side.weight]))
    return Solid(tuple(pieces), tuple(weights), tuple(feet))


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


def _point(turn: npt.NDArray[np.float64], distance_m: float) -> tuple[float, float]:
    x_m, y_m = turn @ np.array([distance_m, 0.0])
    return float(x_m), float(y_m)
