"""Random objects: an outline of a family, and the properties that a push depends on beside it."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from service.pushing.outlines import Outline
from training.shapes.outlines import draw_outline
from training.shapes.pieces import Point, between, log_between

FRICTIONS: Final = (0.1, 0.6)  # of pusher and object, as likely below 0.245 as above
PUSHER_RADII_M: Final = (0.002, 0.015)
LARGEST_PUSHER: Final = 0.25  # of the object's largest extent
LOADED_SHARE: Final = 0.5  # of the objects, whose centre of mass is off the centroid
LOADS: Final = (0.2, 0.6)  # of the mass of such an object, in one point
MASSES_KG_M2: Final = (5.0, 100.0)  # per area: from a printed shell 10 mm high to 13 mm of steel
_NANO: Final = 9  # decimals of places: metres to a nanometre, so that last digits of a processor vanish
_SHARE: Final = 6  # decimals of other numbers


@dataclass(frozen=True)
class DrawnObject:
    """Object drawn at random, with the pusher that pushes it. Places are in the frame of its outline."""

    family: str
    outline: Outline
    centre_of_mass_m: Point
    mass_kg: float
    friction: float  # of pusher and object
    pusher_radius_m: float


def draw_object(family: str, rng: np.random.Generator) -> DrawnObject:
    """Draw an object of a family of ``FAMILIES``. The same generator gives the same object on every processor."""
    outline = draw_outline(family, rng)
    density_kg_m2 = log_between(rng, *MASSES_KG_M2)
    low_m, high_m = PUSHER_RADII_M
    return DrawnObject(
        family,
        outline,
        _centre_of_mass_m(outline, rng),
        round(density_kg_m2 * outline.area_m2, _SHARE),
        round(log_between(rng, *FRICTIONS), _SHARE),
        round(log_between(rng, low_m, min(high_m, LARGEST_PUSHER * outline.extent_m)), _SHARE),
    )


def _centre_of_mass_m(outline: Outline, rng: np.random.Generator) -> Point:
    """Draw the centre of mass: the centroid, or off it because a point inside carries a share of the mass."""
    x, y = outline.centroid_m
    if rng.random() < LOADED_SHARE:
        load = between(rng, *LOADS)
        load_x, load_y = _point_inside(outline, rng)
        x, y = x + load * (load_x - x), y + load * (load_y - y)
    return round(float(x), _NANO), round(float(y), _NANO)


def _point_inside(outline: Outline, rng: np.random.Generator) -> tuple[float, float]:
    """Draw a point of an outline's area, all with the same chance."""
    low, high = outline.corners.min(axis=0), outline.corners.max(axis=0)
    while True:
        point = rng.uniform(low, high)
        if outline.contains(point[None])[0]:
            return float(point[0]), float(point[1])
