"""Pieces of outlines as shapely polygons: rectangles, discs, rounding and unions, in units of the drawing.

Every piece lies on a grid of a millionth of the unit. Sine and cosine differ in last digits between processors, and on
the grid those digits vanish before a union or a simplification decides by them. Coordinates are of the order of 1.
"""

import math
from collections.abc import Iterable, Sequence
from typing import Final

import numpy as np
import shapely
from shapely import Polygon
from shapely.affinity import rotate, translate

GRID: Final = 1e-6
QUADRANT: Final = 24  # corners of a quarter of a circle, before outlines are simplified
ROUNDED_QUADRANT: Final = 8  # likewise of a rounded corner, which is smaller
Point = tuple[float, float]


def polygon(points: Iterable[Point]) -> Polygon:
    """Return the polygon of corners in order, on the grid."""
    return snapped(Polygon(list(points)))


def rectangle(width: float, height: float, centre: Point = (0.0, 0.0)) -> Polygon:
    """Return a rectangle along the axes around a centre."""
    x, y = centre
    return snapped(shapely.box(x - width / 2, y - height / 2, x + width / 2, y + height / 2))


def ellipse(radius_x: float, radius_y: float, centre: Point = (0.0, 0.0)) -> Polygon:
    """Return an ellipse along the axes around a centre."""
    turns = [2.0 * math.pi * number / (4 * QUADRANT) for number in range(4 * QUADRANT)]
    x, y = centre
    return polygon((x + radius_x * math.cos(turn), y + radius_y * math.sin(turn)) for turn in turns)


def disc(radius: float, centre: Point = (0.0, 0.0)) -> Polygon:
    """Return a disc around a centre."""
    return ellipse(radius, radius, centre)


def regular(corners: int, radius: float = 1.0, turn_rad: float = 0.0) -> Polygon:
    """Return a regular polygon around the origin, with its first corner in the direction of an angle."""
    turns = [turn_rad + 2.0 * math.pi * number / corners for number in range(corners)]
    return polygon((radius * math.cos(turn), radius * math.sin(turn)) for turn in turns)


def capsule(start: Point, end: Point, start_width: float, end_width: float | None = None) -> Polygon:
    """Return a bar between two points with round ends, tapered if the widths differ."""
    ends = [disc(start_width / 2, start), disc((end_width or start_width) / 2, end)]
    return whole(shapely.convex_hull(shapely.union_all(ends)))


def rounded(shape: Polygon, radius: float) -> Polygon:
    """Return a polygon whose corners, outer ones first and then inner ones, are rounded by a radius."""
    outer = shape.buffer(-radius, quad_segs=ROUNDED_QUADRANT).buffer(radius, quad_segs=ROUNDED_QUADRANT)
    return whole(outer.buffer(radius, quad_segs=ROUNDED_QUADRANT).buffer(-radius, quad_segs=ROUNDED_QUADRANT))


def united(*shapes: Polygon) -> Polygon:
    """Return the union of polygons that overlap, without holes."""
    return whole(shapely.union_all(list(shapes), grid_size=GRID))


def without(shape: Polygon, *bites: Polygon) -> Polygon:
    """Return a polygon less others. Of several parts the largest is kept."""
    return whole(shapely.difference(shape, shapely.union_all(list(bites), grid_size=GRID), grid_size=GRID))


def whole(shape: shapely.Geometry) -> Polygon:
    """Return the largest part of a geometry, on the grid and without holes."""
    parts = shapely.get_parts(shapely.set_precision(shape, GRID))
    return Polygon(max(parts, key=lambda part: part.area).exterior) if len(parts) else Polygon()


def snapped(shape: Polygon) -> Polygon:
    """Return a polygon whose corners are rounded to the grid."""
    return shapely.transform(shape, lambda places: np.round(places, 6))


def moved(shape: Polygon, offset: Point, turn_rad: float = 0.0) -> Polygon:
    """Return a polygon turned about the origin and then shifted."""
    turned = rotate(shape, turn_rad, origin=(0.0, 0.0), use_radians=True)
    return snapped(translate(turned, *offset))


def between(rng: np.random.Generator, low: float, high: float) -> float:
    """Draw a number evenly between two limits."""
    return float(rng.uniform(low, high))


def log_between(rng: np.random.Generator, low: float, high: float) -> float:
    """Draw a number between two limits, even in its logarithm."""
    return math.exp(between(rng, math.log(low), math.log(high)))


def pick(rng: np.random.Generator, choices: Sequence[int]) -> int:
    """Draw one of several numbers, all with the same chance."""
    return int(choices[int(rng.integers(len(choices)))])
