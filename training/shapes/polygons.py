"""Families of blocks: boxes, rounded boxes, bars, regular and irregular polygons, ellipses, and stars.

Each function draws the proportions of one object as a polygon of the order of 1. ``outlines`` gives it a size.
"""

import math

import numpy as np
from shapely import MultiPoint, Polygon

from training.shapes.pieces import between, capsule, ellipse, pick, polygon, rectangle, regular, rounded, whole


def box(rng: np.random.Generator) -> Polygon:
    """Draw a rectangle, at most 3 times as long as wide."""
    return rectangle(1.0, between(rng, 1.0 / 3.0, 1.0))


def rounded_box(rng: np.random.Generator) -> Polygon:
    """Draw a rectangle whose corners are rounded by 15 to 48 % of its width."""
    width = between(rng, 0.35, 1.0)
    return rounded(rectangle(1.0, width), width * between(rng, 0.15, 0.48))


def bar(rng: np.random.Generator) -> Polygon:
    """Draw a bar, 6 to 16 times as long as wide, with square ends or round ones."""
    width = 1.0 / between(rng, 6.0, 16.0)
    if rng.random() < 0.5:
        return rectangle(1.0, width)
    return capsule((0.0, 0.0), (1.0, 0.0), width, width * between(rng, 0.5, 1.0))


def regular_polygon(rng: np.random.Generator) -> Polygon:
    """Draw a regular polygon of 3 to 8 sides, in half of the draws with rounded corners."""
    sides = pick(rng, (3, 5, 6, 6, 7, 8))
    shape = regular(sides)
    return rounded(shape, between(rng, 0.03, 0.2)) if rng.random() < 0.5 else shape


def irregular_polygon(rng: np.random.Generator) -> Polygon:
    """Draw a polygon of 3 to 9 corners around a middle, convex in half of the draws."""
    corners = pick(rng, (3, 4, 4, 5, 6, 7, 8, 9))
    points = _around(rng, corners, 0.4, 1.0)
    if rng.random() < 0.5:
        return whole(MultiPoint(points).convex_hull)
    return polygon(points)


def disc_or_ellipse(rng: np.random.Generator) -> Polygon:
    """Draw an ellipse, at most 3 times as long as wide. A fifth of them are discs."""
    return ellipse(1.0, 1.0 if rng.random() < 0.2 else between(rng, 1.0 / 3.0, 1.0))


def star(rng: np.random.Generator) -> Polygon:
    """Draw a star of 4 to 8 tips, in half of the draws with rounded ones."""
    tips = pick(rng, (4, 5, 5, 6, 7, 8))
    inner = between(rng, 0.4, 0.65)
    radii = [1.0, inner] * tips
    turns = [math.pi * number / tips for number in range(2 * tips)]
    places = zip(radii, turns, strict=True)
    shape = polygon((radius * math.cos(turn), radius * math.sin(turn)) for radius, turn in places)
    return rounded(shape, between(rng, 0.02, 0.08)) if rng.random() < 0.5 else shape


def _around(rng: np.random.Generator, corners: int, least: float, largest: float) -> list[tuple[float, float]]:
    """Draw corners at increasing angles around the origin, none in the last 35 % of its share of the turn."""
    turns = [2.0 * math.pi * (number + between(rng, 0.0, 0.65)) / corners for number in range(corners)]
    radii = [between(rng, least, largest) for _ in turns]
    places = zip(radii, turns, strict=True)
    return [(radius * math.cos(turn), radius * math.sin(turn)) for radius, turn in places]
