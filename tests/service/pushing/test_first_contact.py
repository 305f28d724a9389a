"""First contact of a round tip with an outline: closed forms, and shapely's distances."""

import math

import numpy as np
import pytest
import shapely

from service.pushing.first_contact import first_contact
from service.pushing.outlines import Outline
from service.pushing.poses import DoubleArray

SQUARE = Outline.of([[-0.05, -0.05], [0.05, -0.05], [0.05, 0.05], [-0.05, 0.05]])
C_SHAPE = Outline.of(
    [[0.0, 0.0], [0.1, 0.0], [0.1, 0.02], [0.03, 0.02], [0.03, 0.08], [0.1, 0.08], [0.1, 0.1], [0.0, 0.1]]
)
TIP_M = 0.005


def test_a_face_is_met_at_the_tips_radius() -> None:
    """A push against a face travels to one radius before it, and the normal is that of the face."""
    found = first_contact(SQUARE, np.array([[-0.1, 0.02, 0.0, 0.06], [0.0, 0.2, -math.pi / 2, 1.0]]), TIP_M)
    assert found.travel_m == pytest.approx([0.045, 0.145])
    assert found.point_m == pytest.approx(np.array([[-0.05, 0.02], [0.0, 0.05]]))
    assert found.normal == pytest.approx(np.array([[1.0, 0.0], [0.0, -1.0]]))


def test_a_corner_is_met_as_a_circle() -> None:
    """A tip whose centre passes beside a face meets the corner, with the normal from the tip's centre to it."""
    found = first_contact(SQUARE, np.array([[-0.1, 0.053, 0.0, 0.06]]), TIP_M)
    assert found.travel_m == pytest.approx([0.05 - 0.004])
    assert found.point_m == pytest.approx(np.array([[-0.05, 0.05]]))
    assert found.normal == pytest.approx(np.array([[0.8, -0.6]]))


@pytest.mark.parametrize(
    "pusher",
    [[-0.1, 0.0, 0.0, 0.044], [-0.1, 0.0551, 0.0, 1.0], [-0.1, 0.0, math.pi, 1.0], [-0.1, 0.0, math.pi / 2, math.inf]],
    ids=["too short", "beside", "away", "along"],
)
def test_a_miss_has_no_contact(pusher: list[float]) -> None:
    """A push that ends before the object, passes beside it or leads away has a travel of inf and no contact point."""
    found = first_contact(SQUARE, np.array([pusher]), TIP_M)
    assert found.travel_m == [math.inf]
    assert np.isnan(found.point_m).all()
    assert np.isnan(found.normal).all()


@pytest.mark.parametrize("x_m", [-0.0549, -0.05, -0.04], ids=["touches", "centre on the face", "centre inside"])
def test_a_tip_that_overlaps_touches_at_once(x_m: float) -> None:
    """A tip that overlaps at the start has no travel, and its contact is the nearest point of the outline."""
    found = first_contact(SQUARE, np.array([[x_m, 0.01, 0.3, 0.05]]), TIP_M)
    assert found.travel_m == [0.0]
    assert found.point_m == pytest.approx(np.array([[-0.05, 0.01]]))
    assert found.normal == pytest.approx(np.array([[1.0, 0.0]]))


def test_every_push_may_have_a_tip_of_its_own() -> None:
    """Radii are one for all or one per push."""
    found = first_contact(SQUARE, np.array([[-0.1, 0.0, 0.0, 1.0]] * 2), np.array([0.002, 0.010]))
    assert found.travel_m == pytest.approx([0.048, 0.040])


def polygon(seed: int) -> DoubleArray:
    """Return a star-shaped polygon with deep notches."""
    rng = np.random.default_rng(seed)
    angle = (np.arange(13) + 0.9 * rng.random(13)) * 2.0 * math.pi / 13
    radius = rng.uniform(0.01, 0.09, 13)
    return np.column_stack([radius * np.cos(angle) + 0.2, radius * np.sin(angle)])


@pytest.mark.parametrize(
    "outline", [C_SHAPE, *(Outline.of(polygon(seed)) for seed in range(3))], ids=["C", "star 0", "star 1", "star 2"]
)
def test_contacts_are_those_of_a_swept_disc(outline: Outline) -> None:
    """At its contact a tip is one radius away, on its way there further, and on the way of a miss always further."""
    rng = np.random.default_rng(7)
    pushers = np.column_stack([rng.uniform(-0.12, 0.12, (800, 2)), rng.uniform(-9.0, 9.0, 800), np.full(800, 0.15)])
    pushers[:, :2] += outline.centroid_m
    found = first_contact(outline, pushers, TIP_M)
    shape = shapely.Polygon(outline.corners)
    direction = np.column_stack([np.cos(pushers[:, 2]), np.sin(pushers[:, 2])])
    hit, overlaps = np.isfinite(found.travel_m), found.travel_m == 0.0
    way_m = np.where(hit, found.travel_m, pushers[:, 3])
    ends = pushers[:, :2] + way_m[:, None] * direction
    nearest = np.array(shapely.distance(shape, shapely.linestrings(np.stack([pushers[:, :2], ends], axis=1))))
    assert (nearest[~hit] > TIP_M).all()
    assert (nearest[overlaps] <= TIP_M).all()
    assert nearest[hit & ~overlaps] == pytest.approx(np.full((hit & ~overlaps).sum(), TIP_M), abs=1e-12)
    moved = hit & ~overlaps
    assert ends[moved] + TIP_M * found.normal[moved] == pytest.approx(found.point_m[moved], abs=1e-12)
    assert ((direction[moved] * found.normal[moved]).sum(axis=1) >= 0.0).all()
    assert min(hit.sum(), (~hit).sum(), overlaps.sum()) > 50


def test_many_pushes_in_chunks_are_the_same_as_one_by_one() -> None:
    """A contact does not depend on the number of pushes that are asked for at once."""
    angle = np.arange(512) * 2.0 * math.pi / 512
    disc = Outline.of(0.05 * np.column_stack([np.cos(angle), np.sin(angle)]))
    pushers = np.column_stack([np.full(500, -0.1), np.linspace(-0.06, 0.06, 500), np.zeros(500), np.ones(500)])
    found = first_contact(disc, pushers, TIP_M)
    one_by_one = [first_contact(disc, pusher[None], TIP_M).travel_m[0] for pusher in pushers[::50]]
    assert (found.travel_m[::50] == one_by_one).all()
    offset = pushers[:, 1]
    circle = 0.1 - np.sqrt(np.maximum((0.05 + TIP_M) ** 2 - offset**2, 0.0))
    near = np.abs(offset) < 0.05
    assert found.travel_m[near] == pytest.approx(circle[near], abs=1e-5)
    assert np.isinf(found.travel_m[np.abs(offset) > 0.0551]).all()


def test_a_tip_that_touches_by_all_but_rounding_does_not_miss() -> None:
    """A tip put exactly onto a slanting edge touches there, on whichever side of it rounding puts the tip."""
    slanting = Outline.of([(0.045, 0.045), (-0.0809, 0.045), (0.045, -0.08087)])
    near = slanting.nearest(np.linspace((-0.06, 0.0), (0.0, -0.06), 100))
    tips = near.point_m - 0.00475 * near.normal
    pushers = np.column_stack([tips, np.full(100, 0.8), np.full(100, 0.05)])

    assert (first_contact(slanting, pushers, 0.00475).travel_m == 0.0).all()
