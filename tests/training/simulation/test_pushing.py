"""Quasi-static pushes: closed forms, symmetries, rods that miss, and outcomes that depend on the seed alone."""

import math

import numpy as np
import numpy.typing as npt
import pytest
from mujoco import rollout

from service.pushing.outlines import Outline
from training.simulation import surfaces
from training.simulation.approach import Approach, draw_pushers
from training.simulation.bodies import RECORDED, Body, Conditions, body, even_conditions
from training.simulation.pieces import convex_pieces
from training.simulation.pushing import push_body, simulate_pushes
from training.simulation.scene import PUSHER_RADIUS_M, push_object
from training.simulation.solids import Solid
from training.simulation.surfaces import Array

RADIUS_M = 0.005
HALF_M = 0.040
SQUARE = Outline.of([(-HALF_M, -HALF_M), (HALF_M, -HALF_M), (HALF_M, HALF_M), (-HALF_M, HALF_M)])
U_SHAPE = Outline.of(
    [(-0.04, -0.04), (0.04, -0.04), (0.04, 0.04), (0.02, 0.04), (0.02, -0.02), (-0.02, -0.02), (-0.02, 0.04),
     (-0.04, 0.04)]
)  # fmt: skip
LEFT_M = -HALF_M - RADIUS_M  # of a rod that touches the left side of the square


def even_body(outline: Outline = SQUARE) -> Body:
    """Return a body whose weight is spread evenly."""
    return body(outline, "even", np.random.default_rng(0))


def push(pushers: npt.ArrayLike, pushed: Body | None = None, contact: float = 0.25) -> Array:
    """Return outcomes without any variation."""
    pushed, poses = pushed or even_body(), np.array(pushers, dtype=np.float64)
    return push_body(pushed, poses, RADIUS_M, even_conditions(pushed, len(poses), contact))


def some_pushers(count: int) -> Array:
    """Return random pushes towards the square from its left side, from touch to 20 mm away."""
    rng = np.random.default_rng(3)
    away, across = rng.uniform(0.0, 0.02, count), rng.uniform(-HALF_M, HALF_M, count)
    return np.column_stack([LEFT_M - away, across, rng.uniform(-0.7, 0.7, count), rng.uniform(0.01, 0.08, count)])


def test_a_push_through_the_centre_of_mass_goes_straight() -> None:
    """The square moves by the length of the push less the way to it, neither sideways nor turning."""
    (outcome,) = push([(LEFT_M - 0.010, 0.0, 0.0, 0.050)])

    assert outcome == pytest.approx([0.040, 0.0, 0.0], abs=1e-9)


def test_the_centre_of_mass_decides_and_not_the_middle() -> None:
    """A push along y = 10 mm goes straight if the centre of mass lies there, and turns the square if not."""
    off_centre = body(SQUARE, "even", np.random.default_rng(0), np.array([0.005, 0.010]))
    straight, turned = (push([(LEFT_M, 0.010, 0.0, 0.030)], pushed)[0] for pushed in (off_centre, even_body()))

    assert straight == pytest.approx([0.030, 0.0, 0.0], abs=1e-4)
    assert turned[2] < -0.05


def test_a_body_on_two_feet_turns_about_the_far_one() -> None:
    """Two feet at the ends of a bar, pushed at one end: the near foot slides on a circle about the other one.

    The force at the near foot is its own friction, so that the far foot never reaches its limit and stays.
    """
    bar = Body(SQUARE, np.zeros(2), np.array([(0.0, -0.03), (0.0, 0.03)]), np.array([0.5, 0.5]))
    (outcome,) = push([(LEFT_M, -0.03, 0.0, 0.010)], bar, contact=0.0)

    turn = outcome[2]
    far = outcome[:2] + 0.03 * np.array([-math.sin(turn), math.cos(turn)])
    assert turn > 0.1
    assert far == pytest.approx([0.0, 0.03], abs=4e-4)


@pytest.mark.parametrize(("angle_rad", "sticks"), [(0.15, True), (1.30, False)])
def test_the_rod_sticks_in_a_steep_push_and_slides_in_a_flat_one(angle_rad: float, sticks: bool) -> None:
    """A rod that sticks carries the contact along. One that slides is ahead of it: friction of 0.25 cannot hold it."""
    (outcome,) = push([(LEFT_M, 0.0, angle_rad, 0.002)])
    contact_y_m = outcome[1] - HALF_M * math.sin(outcome[2])

    assert (abs(0.002 * math.sin(angle_rad) - contact_y_m) < 5e-5) == sticks


def test_a_turned_object_gives_a_turned_answer() -> None:
    """Turning outline and pushes by any angle turns the outcome."""
    angle = 0.7
    turn = np.array([(math.cos(angle), -math.sin(angle)), (math.sin(angle), math.cos(angle))])
    straight = even_body()
    turned = Body(
        Outline.of(SQUARE.corners @ turn.T), straight.centre_of_mass_m, straight.feet_m @ turn.T, straight.loads
    )
    pushers = some_pushers(20)
    expected = push(pushers, straight)
    found = push(np.column_stack([pushers[:, :2] @ turn.T, pushers[:, 2] + angle, pushers[:, 3]]), turned)

    assert np.column_stack([found[:, :2] @ turn, found[:, 2]]) == pytest.approx(expected, abs=1e-6)
    assert np.abs(expected).max(axis=0).min() > 0.01


def test_a_mirrored_push_has_a_mirrored_outcome() -> None:
    """Changing the signs of y and angle of a push changes the signs of y and yaw of the outcome."""
    pushers = some_pushers(20)

    assert push(pushers * (1, -1, -1, 1)) * (1, -1, -1) == pytest.approx(push(pushers), abs=1e-6)


def test_the_frame_of_the_outline_may_have_any_origin() -> None:
    """An outline and pushes that are moved by an offset give the motion about that origin."""
    offset = np.array([0.3, -0.2])
    moved = even_body(Outline.of(SQUARE.corners + offset))
    pushers = some_pushers(10)
    (x, y, yaw), (far_x, far_y, far_yaw) = (
        push(pushers).T,
        push(pushers + np.array([*offset, 0.0, 0.0]), moved).T,
    )

    assert far_yaw == pytest.approx(yaw, abs=1e-6)
    assert far_x + np.cos(yaw) * 0.3 + np.sin(yaw) * 0.2 - 0.3 == pytest.approx(x, abs=1e-6)
    assert far_y + np.sin(yaw) * 0.3 - np.cos(yaw) * 0.2 + 0.2 == pytest.approx(y, abs=1e-6)


def test_a_miss_leaves_the_object_at_rest() -> None:
    """Rods that pass by, point away, or stop before the object move nothing at all."""
    misses = [
        (-0.1, HALF_M + RADIUS_M + 1e-4, 0.0, 0.3),
        (LEFT_M - 0.01, 0.0, math.pi, 0.05),
        (LEFT_M - 0.01, 0.0, 0.0, 0.0099),
    ]

    assert (push(misses) == 0.0).all()


def test_the_rod_never_enters_the_object() -> None:
    """After any push of a U, into its hollow too, the rod overlaps it by less than a tenth of a millimetre."""
    hollow = np.array([(0.0, 0.0, -math.pi / 2 + turn, 0.06) for turn in np.linspace(-0.8, 0.8, 15)])
    pushers = np.concatenate([hollow, some_pushers(30)])
    outcomes = push(pushers, even_body(U_SHAPE))
    rods = pushers[:, :2] + pushers[:, 3:] * np.column_stack([np.cos(pushers[:, 2]), np.sin(pushers[:, 2])])
    away, yaw = rods - outcomes[:, :2], outcomes[:, 2]
    seen = np.column_stack(
        [np.cos(yaw) * away[:, 0] + np.sin(yaw) * away[:, 1], np.cos(yaw) * away[:, 1] - np.sin(yaw) * away[:, 0]]
    )

    assert U_SHAPE.distance_m(seen).min() > RADIUS_M - 1e-4


def test_a_rod_in_a_notch_as_wide_as_itself_carries_the_object_along() -> None:
    """Held by both flanks of a V without friction, the object turns little although the push is off its centre."""
    notch = Outline.of(
        [(-0.04, -0.04), (0.04, -0.04), (0.04, 0.04), (-0.04, 0.04), (-0.04, 0.02), (-0.03, 0.01), (-0.04, 0.0)]
    )
    (held,) = push([(-0.05, 0.01, 0.0, 0.03)], even_body(notch), contact=0.0)
    rod = np.array([-0.02, 0.01])
    cos, sin = math.cos(held[2]), math.sin(held[2])
    tip = held[:2] + np.array([cos * -0.03 - sin * 0.01, sin * -0.03 + cos * 0.01])

    assert np.linalg.norm(rod - tip) == pytest.approx(math.sqrt(2.0) * RADIUS_M, abs=3e-4)


@pytest.mark.parametrize("outline", [SQUARE, U_SHAPE], ids=["square", "U"])
def test_mujoco_agrees_on_the_same_feet(outline: Outline) -> None:
    """Half of the pushes end within 1 mm and 1 degree of MuJoCo's contacts of convex pieces and feet with a plate."""
    pushed = even_body(outline)
    lengths_m = np.full(30, 0.05)
    pushers = draw_pushers(outline, lengths_m, PUSHER_RADIUS_M, np.random.default_rng(1), Approach())
    feet = tuple((float(x), float(y)) for x, y in pushed.feet_m)
    solid = Solid(convex_pieces(outline), (), feet)
    with rollout.Rollout(nthread=0) as pool:
        expected = push_object(solid, pushers[:, :3], surfaces.even_conditions(30), pool, 1)
    found = push_body(pushed, pushers, PUSHER_RADIUS_M, even_conditions(pushed, 30))

    away_m = np.linalg.norm(found[:, :2] - expected[:, :2], axis=1)
    assert np.median(np.linalg.norm(expected[:, :2], axis=1)) > 0.01
    assert np.median(away_m) < 0.001
    assert np.median(np.abs(found[:, 2] - expected[:, 2])) < math.radians(1.0)


def test_a_rod_that_starts_inside_is_moved_out() -> None:
    """An overlap at the start, as the tracker's error makes it, does not throw the object away."""
    inside, touching = push([(LEFT_M + 0.0003, 0.0, 0.0, 0.02), (LEFT_M, 0.0, 0.0, 0.02)])

    assert inside == pytest.approx(touching, abs=1e-9)


def test_a_push_of_a_kilometre_ends() -> None:
    """Its steps are bounded. The rod has lost the object on the way, or still pushes it."""
    (outcome,) = push([(LEFT_M, 0.001, 0.1, 1000.0)])

    assert np.isfinite(outcome).all()
    assert 0.0 < outcome[0] <= 1001.0


def test_no_pushes_are_no_error() -> None:
    """An empty batch has an empty answer."""
    assert push(np.empty((0, 4))).shape == (0, 3)


def test_a_push_does_not_depend_on_the_others() -> None:
    """One push alone has the outcome to the bit that it has among others of other lengths."""
    pushers = some_pushers(9)
    together = push(pushers)

    for row in (0, 4, 8):
        assert (push(pushers[row : row + 1]) == together[row]).all()
    assert (push(np.tile(pushers, (300, 1)))[-9:] == together).all()


def test_a_misplaced_object_is_seen_by_a_tracker_that_errs_alike_before_and_after() -> None:
    """A push that carries the object straight moves the seen frame by the same way, wherever the object truly is."""
    pushed = even_body()
    conditions = even_conditions(pushed, 1)
    misplaced = Conditions(conditions.loads, conditions.contact, np.array([(-0.001, 0.0, 0.0)]))
    (outcome,) = push_body(pushed, np.array([(LEFT_M - 0.01, 0.0, 0.0, 0.05)]), RADIUS_M, misplaced)

    assert outcome == pytest.approx([0.041, 0.0, 0.0], abs=1e-9)


def test_the_seed_decides_the_outcome() -> None:
    """The same seed gives the same bytes, another one another outcome, within millimetres."""
    pushers = some_pushers(20)
    first, again, other = (
        simulate_pushes(even_body(), pushers, RADIUS_M, RECORDED, np.random.default_rng(seed)) for seed in (1, 1, 2)
    )

    assert first.tobytes() == again.tobytes()
    assert 1e-4 < np.abs(first[:, :2] - other[:, :2]).max() < 0.03
