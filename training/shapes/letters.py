"""Families of brackets and profiles: L, T, U, H and Z, crosses, arrows, all made of straight bars.

Each function draws the proportions of one object as a polygon of the order of 1. ``outlines`` gives it a size.
"""

import numpy as np
from shapely import Polygon

from training.shapes.pieces import between, rectangle, rounded, united


def letter_l(rng: np.random.Generator) -> Polygon:
    """Draw an L: two bars that share a corner."""
    width, height = 1.0, between(rng, 0.5, 1.5)
    upright, foot = between(rng, 0.2, 0.45), between(rng, 0.2, 0.45) * min(1.0, height)
    return _softened(rng, united(_corner_box(width, foot), _corner_box(upright, height)), min(upright, foot))


def letter_t(rng: np.random.Generator) -> Polygon:
    """Draw a T: a bar, and a stem from its middle."""
    stem, top, height = between(rng, 0.18, 0.4), between(rng, 0.18, 0.4), between(rng, 0.6, 1.5)
    parts = rectangle(1.0, top), rectangle(stem, height, (0.0, -height / 2))
    return _softened(rng, united(*parts), min(stem, top))


def letter_u(rng: np.random.Generator) -> Polygon:
    """Draw a U: a base, and two arms of different width and length."""
    base, depth = between(rng, 0.18, 0.35), between(rng, 0.5, 1.2)
    left, right = between(rng, 0.15, 0.3), between(rng, 0.15, 0.3)
    other_depth = depth * (between(rng, 0.6, 1.0) if rng.random() < 0.4 else 1.0)
    arms = _corner_box(left, depth), rectangle(right, other_depth, (1.0 - right / 2, other_depth / 2))
    return _softened(rng, united(_corner_box(1.0, base), *arms), min(base, left, right))


def letter_h(rng: np.random.Generator) -> Polygon:
    """Draw an H, the profile of a beam: a web between two flanges."""
    height, web = between(rng, 0.6, 1.4), between(rng, 0.15, 0.4)
    flanges = between(rng, 0.15, 0.28), between(rng, 0.15, 0.28)
    parts = [rectangle(flange, height, (x, 0.0)) for flange, x in zip(flanges, (-0.5, 0.5), strict=True)]
    return _softened(rng, united(rectangle(1.0, web), *parts), min(web, *flanges))


def letter_z(rng: np.random.Generator) -> Polygon:
    """Draw a Z with right angles: a web with a flange to either side."""
    web, height = between(rng, 0.18, 0.35), between(rng, 0.8, 1.4)
    thick, left, right = between(rng, 0.18, 0.3), between(rng, 0.3, 0.7), between(rng, 0.3, 0.7)
    top = rectangle(left + web / 2, thick, ((web / 2 - left) / 2, height / 2 - thick / 2))
    bottom = rectangle(right + web / 2, thick, ((right - web / 2) / 2, thick / 2 - height / 2))
    return _softened(rng, united(rectangle(web, height), top, bottom), min(web, thick))


def cross(rng: np.random.Generator) -> Polygon:
    """Draw a cross: two bars over each other, in half of the draws not in the middle."""
    across, along, height = between(rng, 0.18, 0.4), between(rng, 0.18, 0.4), between(rng, 0.7, 1.5)
    shift = between(rng, -0.25, 0.25) * height if rng.random() < 0.5 else 0.0
    parts = rectangle(1.0, across, (0.0, shift)), rectangle(along, height)
    return _softened(rng, united(*parts), min(across, along))


def _corner_box(width: float, height: float) -> Polygon:
    """Return a rectangle whose lower left corner is the origin."""
    return rectangle(width, height, (width / 2, height / 2))


def _softened(rng: np.random.Generator, shape: Polygon, thickness: float) -> Polygon:
    """Return the shape, in 40 % of the draws with corners rounded by up to 0.3 of its least thickness."""
    return rounded(shape, thickness * between(rng, 0.1, 0.3)) if rng.random() < 0.4 else shape
