"""Quasi-static mechanics: closed forms of discs and single contacts, symmetries, and pushes that miss."""

import math

import numpy as np
import pytest

from service.pushing.mechanics import moment_arm_m, push
from service.pushing.outlines import Outline
from service.pushing.poses import DoubleArray

TIP_M = 0.005
SQUARE = Outline.of([[-0.05, -0.05], [0.05, -0.05], [0.05, 0.05], [-0.05, 0.05]])
SQUARE_ARM_M = 0.1 * (math.sqrt(2.0) + math.asinh(1.0)) / 6.0
L_SHAPE = Outline.of([[0.0, 0.0], [0.1, 0.0], [0.1, 0.03], [0.03, 0.03], [0.03, 0.08], [0.0, 0.08]])
TRIANGLE = Outline.of([[0.045, 0.045], [-0.0809, 0.045], [0.045, -0.08087]])


NOTCHED = Outline.of(
    [[-0.05, -0.05], [0.05, -0.05], [0.05, 0.05], [-0.05, 0.05], [-0.05, 0.02], [-0.03, 0.0], [-0.05, -0.02]]
)


def disc(radius_m: float) -> Outline:
    """Return a regular polygon that is a disc within 0.002 % of its radius."""
    angle = np.arange(512) * 2.0 * math.pi / 512
    return Outline.of(radius_m * np.column_stack([np.cos(angle), np.sin(angle)]))


def around(outline: Outline, count: int, length_m: float = 0.05) -> DoubleArray:
    """Return pushes (count, 4) from all around an outline, aimed at it and past it."""
    rng = np.random.default_rng(5)
    bearing = rng.uniform(-math.pi, math.pi, count)
    start = outline.centroid_m + outline.extent_m * np.column_stack([np.cos(bearing), np.sin(bearing)])
    aim = bearing + math.pi + rng.uniform(-0.5, 0.5, count)
    return np.column_stack([start, aim, np.full(count, length_m + outline.extent_m / 2.0)])


@pytest.mark.parametrize("outline", [SQUARE, L_SHAPE, TRIANGLE], ids=["square", "L", "triangle"])
def test_the_moment_arm_is_the_mean_distance_of_the_area(outline: Outline) -> None:
    """The sum over edges is the mean over a fine grid, from the centroid, from a corner and from outside."""
    points = outline.samples(outline.extent_m / 500)
    for about in (outline.centroid_m, outline.corners[1], outline.centroid_m + 0.2):
        mean_m = np.sqrt(((points - about) ** 2).sum(axis=1)).mean()
        assert moment_arm_m(outline, about) == pytest.approx(mean_m, rel=5e-3)


def test_the_moment_arms_of_disc_and_square_are_known() -> None:
    """A disc has two thirds of its radius, and a square (sqrt 2 + asinh 1) / 6 of its side."""
    assert moment_arm_m(disc(0.06), np.zeros(2)) == pytest.approx(0.04, rel=1e-4)
    assert moment_arm_m(SQUARE, np.zeros(2)) == pytest.approx(SQUARE_ARM_M, rel=1e-12)


def test_a_push_through_the_centre_moves_along_and_does_not_turn() -> None:
    """A push at right angles to a face, through the centre, moves the object by the travel after contact."""
    pushers = np.array([[-0.08, 0.0, 0.0, 0.05], [0.0, 0.09, -math.pi / 2, 0.05]])
    expected = np.array([[0.025, 0.0, 0.0], [0.0, -0.015, 0.0]])
    assert push(SQUARE, pushers, TIP_M) == pytest.approx(expected, abs=1e-12)


def test_a_push_through_a_given_centre_of_mass_does_not_turn() -> None:
    """The centre of mass decides what turns: a push through it does not, and one through the centroid does."""
    pushers = np.array([[-0.08, 0.02, 0.0, 0.05], [-0.08, 0.0, 0.0, 0.05]])
    found = push(SQUARE, pushers, TIP_M, centre_of_mass_m=[0.0, 0.02])
    assert found[0] == pytest.approx([0.025, 0.0, 0.0], abs=1e-12)
    assert found[1, 2] > 0.05


@pytest.mark.parametrize("angle_rad", [-0.15, 0.0, 0.2])
def test_a_contact_that_sticks_moves_as_published(angle_rad: float) -> None:
    """A short push within the motion cone turns and moves the object as in Lynch, Maekawa, Tanie 1992."""
    c, x, y, d = SQUARE_ARM_M, -0.05, -0.01, 1e-6
    pusher = np.array([[x - TIP_M, y, angle_rad, d]])
    ux, uy = d * math.cos(angle_rad), d * math.sin(angle_rad)
    vx = ((c**2 + x**2) * ux + x * y * uy) / (c**2 + x**2 + y**2)
    vy = (x * y * ux + (c**2 + y**2) * uy) / (c**2 + x**2 + y**2)
    assert push(SQUARE, pusher, TIP_M, friction=0.9)[0] == pytest.approx([vx, vy, (x * vy - y * vx) / c**2], rel=1e-4)


@pytest.mark.parametrize("angle_rad", [0.9, 1.2])
def test_a_contact_that_slides_pushes_along_the_edge_of_the_friction_cone(angle_rad: float) -> None:
    """A steep push moves the object along the cone's edge, as far as its motion along the normal asks for."""
    mu, c, x, y, d = 0.25, SQUARE_ARM_M, -0.05, -0.01, 1e-6
    found = push(SQUARE, np.array([[x - TIP_M, y, angle_rad, d]]), TIP_M, friction=mu)[0]
    assert found[1] / found[0] == pytest.approx(mu, rel=1e-4)
    assert found[2] * c**2 == pytest.approx(x * found[1] - y * found[0], rel=1e-4)
    assert found[0] - y * found[2] == pytest.approx(d * math.cos(angle_rad), rel=1e-4)


def test_sticking_and_sliding_meet_at_the_edge_of_the_motion_cone() -> None:
    """On either side of the motion cone's edge the motion is the same."""
    mu, c, x, y = 0.25, SQUARE_ARM_M, -0.05, -0.01
    lever = np.array([-y, x])
    edge = np.array([1.0, mu])
    limit = edge + lever * (lever @ edge) / c**2
    angle = math.atan2(limit[1], limit[0])
    inside, at, outside = push(
        SQUARE, np.array([[x - TIP_M, y, angle + off, 1e-6] for off in (-1e-6, 0.0, 1e-6)]), TIP_M, friction=mu
    )
    assert inside == pytest.approx(at, rel=1e-4)
    assert outside == pytest.approx(at, rel=1e-4)
    assert at[1] / at[0] == pytest.approx(mu, rel=1e-4)


def test_a_disc_without_friction_leaves_the_tip_as_the_closed_form_says() -> None:
    """The bearing phi of a disc's centre from the tip grows as tan(phi / 2) = tan(phi_0 / 2) exp(travel / distance)."""
    radius_m, offset_m, travel_m = 0.05, 0.02, 0.06
    reach_m = radius_m + TIP_M
    start = math.asin(offset_m / reach_m)
    pusher = np.array([[-reach_m * math.cos(start), -offset_m, 0.0, travel_m]])
    end = 2.0 * math.atan(math.tan(start / 2.0) * math.exp(travel_m / reach_m))
    x, y, yaw = push(disc(radius_m), pusher, TIP_M, friction=0.0)[0]
    assert x == pytest.approx(pusher[0, 0] + travel_m + reach_m * math.cos(end), abs=2e-5)
    assert y == pytest.approx(-offset_m + reach_m * math.sin(end), abs=2e-5)
    assert yaw == pytest.approx(0.0, abs=1e-3)


def test_a_tip_in_a_notch_carries_the_object_along() -> None:
    """A tip that rests on both sides of a notch of 90 degrees moves the object as far as itself, without a turn."""
    travel_m = 0.07 - (0.05 - 0.006 * math.sqrt(2.0))
    found = push(NOTCHED, np.array([[-0.08, 0.0, 0.0, 0.07]]), 0.006)
    assert found[0] == pytest.approx([travel_m, 0.0, 0.0], abs=5e-5)


@pytest.mark.parametrize("outline", [NOTCHED, L_SHAPE], ids=["notch", "L"])
def test_a_tip_does_not_enter_a_notched_object(outline: Outline) -> None:
    """After pushes into a notch the tips touch the object or are away from it, and more steps change little."""
    pushers = around(outline, 200)
    found = push(outline, pushers, TIP_M)
    ends = pushers[:, :2] + pushers[:, 3:] * np.column_stack([np.cos(pushers[:, 2]), np.sin(pushers[:, 2])])
    off, cos, sin = ends - found[:, :2], np.cos(found[:, 2]), np.sin(found[:, 2])
    seen = np.column_stack([cos * off[:, 0] + sin * off[:, 1], cos * off[:, 1] - sin * off[:, 0]])
    assert outline.distance_m(seen).min() > 0.95 * TIP_M
    assert np.median(np.abs(found - push(outline, pushers, TIP_M, steps=200))) < 1e-4


def test_a_miss_stays_exactly_at_rest() -> None:
    """An object that the tip does not reach, or leaves at once, has an outcome of zeros."""
    pushers = np.array([[-0.1, 0.2, 0.0, 0.05], [-0.1, 0.0, 0.0, 0.04], [-0.055, 0.0, math.pi, 0.05]])
    assert (push(L_SHAPE, pushers, TIP_M) == 0.0).all()
    assert push(L_SHAPE, np.empty((0, 4)), TIP_M).shape == (0, 3)


def test_a_tip_that_has_left_the_object_moves_it_no_further() -> None:
    """A glancing push that has passed the object has the same outcome, however long it is."""
    pushers = np.array([[-0.06, 0.04, 0.9, length] for length in (0.08, 0.10, 0.12)])
    found = push(SQUARE, pushers, TIP_M, steps=100)
    assert abs(found[0, 2]) > 0.02
    assert found[1:] == pytest.approx(np.tile(found[0], (2, 1)), abs=1e-4)


def test_an_overlap_at_the_start_is_a_touch() -> None:
    """A tip that overlaps by a measurement's error does not push the object out of itself first."""
    pushers = np.array([[-0.055, 0.01, 0.2, 0.05], [-0.0548, 0.01, 0.2, 0.05]])
    touching, overlapping = push(SQUARE, pushers, TIP_M)
    assert overlapping == pytest.approx(touching, abs=5e-4)


def test_twice_the_size_and_the_push_are_twice_the_answer() -> None:
    """Mechanics has no length of its own: answers scale exactly, and turns stay the same."""
    pushers = around(L_SHAPE, 60)
    larger = Outline.of(2.0 * L_SHAPE.corners)
    found = push(larger, pushers * [2.0, 2.0, 1.0, 2.0], 2.0 * TIP_M)
    assert (found == push(L_SHAPE, pushers, TIP_M) * [2.0, 2.0, 1.0]).all()


def test_a_turned_and_shifted_scene_has_the_turned_and_shifted_answer() -> None:
    """The frame is the caller's: the same object and push in another frame move the same way."""
    pushers = around(L_SHAPE, 60)
    cos, sin, shift = math.cos(0.7), math.sin(0.7), np.array([0.4, -0.3])
    turn = np.array([[cos, sin], [-sin, cos]])
    turned = np.column_stack([pushers[:, :2] @ turn + shift, pushers[:, 2] + 0.7, pushers[:, 3]])
    found = push(Outline.of(L_SHAPE.corners @ turn + shift), turned, TIP_M)
    expected = push(L_SHAPE, pushers, TIP_M)
    yaw_cos, yaw_sin = np.cos(expected[:, 2]), np.sin(expected[:, 2])
    swung = np.column_stack([yaw_cos * shift[0] - yaw_sin * shift[1], yaw_sin * shift[0] + yaw_cos * shift[1]])
    assert found[:, 2] == pytest.approx(expected[:, 2], abs=1e-9)
    assert found[:, :2] == pytest.approx(expected[:, :2] @ turn + shift - swung, abs=1e-9)


def test_a_mirrored_scene_has_the_mirrored_answer() -> None:
    """Mirrored at the x axis, objects move and turn mirrored."""
    pushers = around(L_SHAPE, 60)
    found = push(Outline.of(L_SHAPE.corners * [1.0, -1.0]), pushers * [1.0, -1.0, -1.0, 1.0], TIP_M)
    assert found == pytest.approx(push(L_SHAPE, pushers, TIP_M) * [1.0, -1.0, -1.0], abs=1e-9)


@pytest.mark.parametrize("outline", [SQUARE, L_SHAPE, TRIANGLE], ids=["square", "L", "triangle"])
def test_more_steps_change_little(outline: Outline) -> None:
    """Twelve steps are near 200, and the default is nearer."""
    pushers = around(outline, 100)
    fine = push(outline, pushers, TIP_M, steps=200)
    moved = np.abs(fine).sum(axis=1) > 0.0
    assert 40 < moved.sum() <= 100
    for steps, limit_m in ((12, 4e-4), (25, 1.5e-4)):
        off = np.abs(push(outline, pushers, TIP_M, steps=steps) - fine)[moved]
        assert off[:, :2].mean() < limit_m
    assert (push(outline, pushers, TIP_M) == push(outline, pushers, TIP_M, steps=25)).all()


def test_tips_and_friction_may_differ_from_push_to_push() -> None:
    """Radii and coefficients (n,) give each push the answer that it has alone."""
    pushers, radius, friction = around(L_SHAPE, 8), np.linspace(0.002, 0.015, 8), np.linspace(0.1, 0.6, 8)
    found = push(L_SHAPE, pushers, radius, friction)
    alone = [push(L_SHAPE, pusher[None], tip, mu)[0] for pusher, tip, mu in zip(pushers, radius, friction, strict=True)]
    assert found == pytest.approx(np.array(alone), abs=1e-12)


def test_an_answer_is_in_the_interval_of_angles() -> None:
    """An object that is turned by more than half a turn has a yaw in (-pi, pi]."""
    bar = Outline.of([[-0.1, -0.005], [0.1, -0.005], [0.1, 0.005], [-0.1, 0.005]])
    pushers = np.column_stack([np.full(40, -0.06), np.full(40, 0.015), np.full(40, -1.5), np.linspace(0.05, 0.6, 40)])
    found = push(bar, pushers, TIP_M, friction=0.6, steps=100)
    assert (np.abs(found[:, 2]) <= math.pi).all()
    assert np.abs(found[:, 2]).max() > 1.0
