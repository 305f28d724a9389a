"""Families without a plan: smooth blobs, beans, and unions of pieces.

Each function draws the proportions of one object as a polygon of the order of 1. ``outlines`` gives it a size.
"""

import math
from itertools import pairwise
from typing import Final

import numpy as np
from shapely import Polygon

from training.shapes.letters import cross, letter_l, letter_t
from training.shapes.pieces import between, capsule, moved, polygon, rounded, united
from training.shapes.polygons import bar, box, disc_or_ellipse, irregular_polygon, regular_polygon, rounded_box

BLOB_CORNERS: Final = 160
PIECES: Final = (box, rounded_box, disc_or_ellipse, irregular_polygon, regular_polygon, bar, letter_l, letter_t, cross)


def blob(rng: np.random.Generator) -> Polygon:
    """Draw a smooth blob: a circle whose radius swings with the second to the sixth harmonic of the angle."""
    waves = [(order, between(rng, 0.1, 0.9) / order**1.5, between(rng, 0.0, 2.0 * math.pi)) for order in range(2, 7)]
    turns = [2.0 * math.pi * number / BLOB_CORNERS for number in range(BLOB_CORNERS)]
    places = []
    for turn in turns:
        swing = sum(height * math.cos(order * turn + phase) for order, height, phase in waves)
        radius = math.exp(swing)
        places.append((radius * math.cos(turn), radius * math.sin(turn)))
    return rounded(polygon(places), 0.03)


def bean(rng: np.random.Generator) -> Polygon:
    """Draw a bean: a thick arc of a circle with round ends of different size."""
    span, bend = math.radians(between(rng, 60.0, 170.0)), between(rng, 0.8, 1.4)
    first, last = between(rng, 0.35, 0.6), between(rng, 0.35, 0.6)
    steps = [number / 12 for number in range(13)]
    places = [(bend * math.cos(span * (step - 0.5)), bend * math.sin(span * (step - 0.5))) for step in steps]
    widths = [2.0 * (first + (last - first) * step) for step in steps]
    links = [capsule(*ends, *sides) for ends, sides in zip(pairwise(places), pairwise(widths), strict=True)]
    return rounded(united(*links), 0.1)


def union(rng: np.random.Generator) -> Polygon:
    """Draw a union of 2 to 4 pieces of other families, each centred on the outline of those before it."""
    shape = _piece(rng)
    for _ in range(int(rng.integers(1, 4))):
        place = shape.exterior.interpolate(float(rng.random()), normalized=True)
        shape = united(shape, moved(_piece(rng), (place.x, place.y)))
    return rounded(shape, 0.02)


def _piece(rng: np.random.Generator) -> Polygon:
    """Draw one piece about the origin at any angle, with a scale of its own."""
    shape = PIECES[int(rng.integers(len(PIECES)))](rng)
    centre = shape.centroid
    centred = moved(shape, (-centre.x, -centre.y))
    scale = between(rng, 0.5, 1.0)
    points = [(scale * x, scale * y) for x, y in centred.exterior.coords[:-1]]
    return moved(polygon(points), (0.0, 0.0), between(rng, 0.0, 2.0 * math.pi))
