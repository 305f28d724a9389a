"""Random objects: properties within their limits, and some centres of mass off the centroid."""

import numpy as np
import pytest
from shapely import Point, Polygon

from training.shapes.families import FAMILIES
from training.shapes.objects import (
    FRICTIONS,
    LARGEST_PUSHER,
    LOADED_SHARE,
    MASSES_KG_M2,
    PUSHER_RADII_M,
    DrawnObject,
    draw_object,
)


@pytest.fixture(scope="module")
def drawn() -> list[DrawnObject]:
    """Ten objects of each family."""
    return [draw_object(family, np.random.default_rng([1, seed])) for family in FAMILIES for seed in range(10)]


def test_properties_are_within_their_limits(drawn: list[DrawnObject]) -> None:
    """Friction, pusher and mass per area spread over their whole ranges."""
    for values, (low, high) in (
        ([item.friction for item in drawn], FRICTIONS),
        ([item.pusher_radius_m for item in drawn], PUSHER_RADII_M),
        ([item.mass_kg / item.outline.area_m2 for item in drawn], MASSES_KG_M2),
    ):
        assert low * 0.99 <= min(values) < 1.3 * low
        assert 0.75 * high < max(values) <= high * 1.01


def test_small_objects_have_small_pushers(drawn: list[DrawnObject]) -> None:
    """A pusher's radius is at most a quarter of the object's extent."""
    assert all(item.pusher_radius_m <= LARGEST_PUSHER * item.outline.extent_m + 1e-6 for item in drawn)


def test_half_of_the_centres_of_mass_are_off_the_centroid(drawn: list[DrawnObject]) -> None:
    """A load moves the centre of mass by up to more than half of the object's size, and never out of its hull."""
    offsets = np.array(
        [
            np.linalg.norm(np.array(item.centre_of_mass_m) - item.outline.centroid_m) / item.outline.size_m
            for item in drawn
        ]
    )

    assert np.mean(offsets > 1e-6) == pytest.approx(LOADED_SHARE, abs=0.12)
    assert 0.5 < offsets.max() < 1.2
    hulls = [Polygon(item.outline.corners).convex_hull for item in drawn]
    assert all(hull.contains(Point(item.centre_of_mass_m)) for hull, item in zip(hulls, drawn, strict=True))


def test_objects_depend_on_the_seed_alone(drawn: list[DrawnObject]) -> None:
    """The same seed gives the same object, and another seed another one."""
    again, other = (draw_object("box", np.random.default_rng([1, seed])) for seed in (0, 10))

    assert (again.mass_kg, again.friction, again.pusher_radius_m) == (
        drawn[0].mass_kg,
        drawn[0].friction,
        drawn[0].pusher_radius_m,
    )
    assert np.array_equal(again.outline.corners, drawn[0].outline.corners)
    assert not np.array_equal(other.outline.corners, drawn[0].outline.corners)
