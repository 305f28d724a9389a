"""Families of things from a workshop and a kitchen, from above: wrench, hammer, screwdriver, bottle, mug, pan, spoon.

Each function draws the proportions of one object as a polygon of the order of 1. It lies along x, with its head or
mouth towards +x. ``outlines`` gives it a size.
"""

import math

import numpy as np
from shapely import Polygon

from training.shapes.pieces import (
    between,
    capsule,
    disc,
    ellipse,
    moved,
    polygon,
    rectangle,
    regular,
    rounded,
    united,
    without,
)


def wrench(rng: np.random.Generator) -> Polygon:
    """Draw an open-ended wrench: a shaft, a jaw at one end, and another jaw or a ring at the other."""
    shaft, head = between(rng, 0.09, 0.14), between(rng, 0.13, 0.18)
    other = head * between(rng, 0.7, 0.95)
    parts = capsule((0.0, 0.0), (1.0, 0.0), shaft), disc(head, (1.0, 0.0)), disc(other, (0.0, 0.0))
    body = rounded(united(*parts), 0.03)
    tilt = math.radians(between(rng, 10.0, 20.0))
    bites = [_jaw(head, (1.0, 0.0), tilt)]
    if rng.random() < 0.5:
        bites.append(_jaw(other, (0.0, 0.0), math.pi + tilt))
    return without(body, *bites)


def hammer(rng: np.random.Generator) -> Polygon:
    """Draw a hammer: a handle that widens towards its end, and a head across it with a face and a peen."""
    handle, head = between(rng, 0.07, 0.12), between(rng, 0.14, 0.2)
    face, peen = between(rng, 0.16, 0.26), between(rng, 0.2, 0.36)
    tip = head * between(rng, 0.15, 0.6)
    profile = [(-head / 2, -face), (head / 2, -face), (head / 2, peen / 3), (tip / 2, peen), (-tip / 2, peen)]
    block = moved(rounded(polygon([*profile, (-head / 2, peen / 3)]), 0.1 * tip), (1.0, 0.0))
    cheek = rectangle(1.25 * head, 0.1, (1.0 - 0.02, -face + 0.05))
    grip = capsule((0.0, 0.0), (between(rng, 0.3, 0.45), 0.0), handle * 1.35, handle)
    return united(grip, rectangle(1.0, handle, (0.5, 0.0)), block, rounded(cheek, 0.02))


def screwdriver(rng: np.random.Generator) -> Polygon:
    """Draw a screwdriver: a thick handle with a waist, and a blade."""
    thick, length = between(rng, 0.14, 0.24), between(rng, 0.35, 0.5)
    blade = thick * between(rng, 0.25, 0.4)
    handle = rounded(rectangle(length, thick, (length / 2, 0.0)), 0.3 * thick)
    waists = [disc(0.2 * thick, (length * 0.8, side * thick * 0.6)) for side in (-1.0, 1.0)]
    end = 1.0 - blade
    tip = polygon([(end, -blade / 2), (1.0, -blade / 3), (1.0, blade / 3), (end, blade / 2)])
    shaft = rectangle(end - length / 2, blade, ((end + length / 2) / 2, 0.0))
    return united(without(handle, *waists), shaft, tip)


def bottle(rng: np.random.Generator) -> Polygon:
    """Draw a bottle that lies on its side: a body, shoulders, a neck and a cap."""
    body, neck = between(rng, 0.26, 0.42), between(rng, 0.09, 0.14)
    length, shoulder = between(rng, 0.5, 0.65), between(rng, 0.08, 0.2)
    half, thin = body / 2, neck / 2
    profile = [(0.0, half), (length, half), (length + shoulder, thin), (0.93, thin)]
    sides = polygon([*profile, *((x, -y) for x, y in reversed(profile))])
    cap = rectangle(0.09, neck * 1.25, (0.955, 0.0))
    return united(rounded(sides, min(0.06, thin * 0.8)), cap)


def mug(rng: np.random.Generator) -> Polygon:
    """Draw a mug that stands: a round wall, and the handle as a bar that points outwards."""
    thick, length = between(rng, 0.16, 0.26), between(rng, 0.45, 0.7)
    bar = rounded(rectangle(1.0 + length, thick, ((1.0 + length) / 2, 0.0)), 0.35 * thick)
    return rounded(united(disc(1.0), bar), 0.05)


def pan(rng: np.random.Generator) -> Polygon:
    """Draw a frying pan: a disc with a long handle that widens towards its end."""
    width, length = between(rng, 0.2, 0.32), between(rng, 1.0, 1.9)
    handle = capsule((0.0, 0.0), (1.0 + length, 0.0), width * 0.8, width * 1.2)
    return rounded(united(disc(1.0), handle), 0.06)


def spoon(rng: np.random.Generator) -> Polygon:
    """Draw a spoon: an oval bowl, and a thin handle that widens towards its end."""
    bowl, width = between(rng, 0.13, 0.18), between(rng, 0.16, 0.24) / 2
    neck = between(rng, 0.04, 0.06)
    handle = capsule((0.0, 0.0), (1.0, 0.0), neck * between(rng, 1.2, 2.0), neck)
    return rounded(united(ellipse(bowl, width, (1.0, 0.0)), handle), 0.015)


def key(rng: np.random.Generator) -> Polygon:
    """Draw a key: a round or angular bow, a shaft, and two to four teeth on one side."""
    bow, shaft = between(rng, 0.2, 0.28), between(rng, 0.09, 0.14)
    ring = disc(bow) if rng.random() < 0.5 else rounded(regular(6, bow * 1.1), 0.05)
    count, teeth = int(rng.integers(2, 5)), []
    for number in range(count):
        depth = shaft * between(rng, 0.5, 1.1)
        teeth.append(rectangle(0.06, depth + shaft / 2, (0.97 - 0.11 * number, -(depth + shaft / 2) / 2)))
    return united(ring, rectangle(1.0, shaft, (0.5, 0.0)), *teeth)


def _jaw(head: float, centre: tuple[float, float], direction_rad: float) -> Polygon:
    """Return the space between the cheeks of a jaw: a slot with a bottom of two slopes, open in a direction."""
    half = 0.5 * head
    slot = [(-0.35 * head, 0.0), (-0.1 * head, -half), (2.0 * head, -half), (2.0 * head, half), (-0.1 * head, half)]
    return moved(polygon(slot), centre, direction_rad)
