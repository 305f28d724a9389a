"""Sides of Omnipush's objects: areas, directions, and agreement with the pieces that the simulator is given."""

import math

import numpy as np
import pytest

from service.pushing.contexts import ObjectContext
from service.pushing.outlines import Outline
from service.pushing.sides import (
    CIRCLE_RADIUS_M,
    CONCAVE_BITE_DEPTH_M,
    CONCAVE_DEPTH_M,
    CORE_HALF_WIDTH_M,
    RECTANGLE_DEPTH_M,
    TRIANGLE_DEPTH_M,
    outline,
    quarter_turn,
)

WIDTH_M = 2.0 * CORE_HALF_WIDTH_M


def outline_of(descriptor: str) -> Outline:
    """Return the outline of a descriptor."""
    return outline(ObjectContext.from_descriptor(descriptor))


@pytest.mark.parametrize(
    ("shape", "side_area_m2"),
    [
        ("2", 0.5 * WIDTH_M * TRIANGLE_DEPTH_M),
        ("3", 0.5 * math.pi * CIRCLE_RADIUS_M**2),
        ("4", WIDTH_M * RECTANGLE_DEPTH_M),
    ],
)
def test_an_outline_has_the_area_of_core_and_sides(shape: str, side_area_m2: float) -> None:
    """An outline encloses the core and its four sides, a half disc of 24 corners within 1 %."""
    assert outline_of(f"{shape}a" * 4).area_m2 == pytest.approx(WIDTH_M**2 + 4.0 * side_area_m2, rel=0.01)


def test_each_side_faces_its_axis() -> None:
    """The four sides reach along +x, +y, -x and -y as far as their shapes are deep."""
    reach = [
        CORE_HALF_WIDTH_M + depth
        for depth in (CONCAVE_DEPTH_M - CONCAVE_BITE_DEPTH_M, TRIANGLE_DEPTH_M, CIRCLE_RADIUS_M, RECTANGLE_DEPTH_M)
    ]
    axes = np.array([(1, 0), (0, 1), (-1, 0), (0, -1)])
    distances = outline_of("1a2a3a4a").distance_m(axes * np.array(reach)[:, None])
    assert distances == pytest.approx(np.zeros(4), abs=1e-4)  # of 24 corners of a half disc, none lies on its axis


def test_a_turned_object_has_the_turned_outline() -> None:
    """Turning the sides by one place turns the outline by +90 degrees, to the bit."""
    context = ObjectContext.from_descriptor("1a2a3a4a")
    turned = outline(context).corners @ quarter_turn(1).T
    found = outline(context.turned(1)).corners
    assert {tuple(corner) for corner in turned + 0.0} == {tuple(corner) for corner in found + 0.0}


def test_weights_do_not_change_an_outline() -> None:
    """Objects that differ by their weights only have one outline."""
    assert np.array_equal(outline_of("2a3a4a1a").corners, outline_of("2C3b4a1a").corners)
