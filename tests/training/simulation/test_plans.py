"""Named plans: the ring as it was, and the approach with starts from touch and aims over the whole object."""

import math

import numpy as np
import pytest

from service.pushing.contexts import ObjectContext
from service.pushing.poses import PUSH_LENGTH_M
from training.simulation.approach import travel_to_touch_m
from training.simulation.exact import directions
from training.simulation.plans import (
    AIM_RADIUS_M,
    APPROACH,
    DEFAULT_PLAN,
    OMNIPUSH_APPROACH,
    PLANS,
    RING,
    START_CLEARANCE_M,
    START_RADIUS_M,
    Plan,
    sample_pushers,
)
from training.simulation.scene import PUSHER_RADIUS_M
from training.simulation.solids import Solid, clearance_m, outline, solid


def body_of(descriptor: str) -> Solid:
    """Return the solid of a descriptor."""
    return solid(ObjectContext.from_descriptor(descriptor))


@pytest.mark.parametrize("descriptor", ["1a1b1c1a", "2a2B2C2c", "3a3a3a3a", "4a4b4c4a"])
def test_pushes_start_clear_of_the_object_and_point_at_it(descriptor: str) -> None:
    """Pushes start in the declared ring, clear of every piece, and their line passes the centre closely, ahead."""
    body = body_of(descriptor)
    pushers = sample_pushers(body, 200, np.random.default_rng(1))
    start, heading = pushers[:, :2], np.column_stack([np.cos(pushers[:, 2]), np.sin(pushers[:, 2])])

    radius = np.linalg.norm(start, axis=1)
    clearance = np.min([clearance_m(piece, start) for piece in body.pieces], axis=0)
    off_centre = np.abs(start[:, 0] * heading[:, 1] - start[:, 1] * heading[:, 0])
    assert pushers.shape == (200, 3)
    assert (np.abs(pushers[:, 2]) <= math.pi).all()
    assert ((START_RADIUS_M[0] <= radius) & (radius <= START_RADIUS_M[1])).all()
    assert (clearance > PUSHER_RADIUS_M + START_CLEARANCE_M).all()
    assert (off_centre <= AIM_RADIUS_M).all()
    assert ((start * heading).sum(axis=1) < 0.0).all()


def test_starts_inside_the_object_are_drawn_again() -> None:
    """Around an object that fills half the ring only the free half is used, and the count is still met."""
    wall = np.array([(0.0, -1.0), (1.0, -1.0), (1.0, 1.0), (0.0, 1.0)])
    pushers = sample_pushers(Solid((wall,), (), ()), 50, np.random.default_rng(2))

    assert len(pushers) == 50
    assert (pushers[:, 0] < -(PUSHER_RADIUS_M + START_CLEARANCE_M)).all()


@pytest.mark.parametrize("plan", [pytest.param(plan, id=plan.name) for plan in PLANS.values()])
@pytest.mark.parametrize("descriptor", ["1a1b1c1a", "2a2B2C2c", "3a3a3a3a", "1a4b2c3a"])
def test_no_plan_starts_inside_an_object(plan: Plan, descriptor: str) -> None:
    """Every start is clear of every piece by more than the tip, and angles are in (-pi, pi]."""
    pushers = plan.draw(ObjectContext.from_descriptor(descriptor), 200, np.random.default_rng(3))
    clearance = np.min([clearance_m(piece, pushers[:, :2]) for piece in body_of(descriptor).pieces], axis=0)

    assert pushers.shape == (200, 3)
    assert (clearance > PUSHER_RADIUS_M).all()
    assert (np.abs(pushers[:, 2]) <= math.pi).all()


def test_the_approach_has_its_share_of_misses_and_starts_from_touch_to_a_length_away() -> None:
    """The set share of the pushes never touches, and the gaps of the others fill the length of a push evenly."""
    context = ObjectContext.from_descriptor("1a2b3c4a")
    pushers = APPROACH.draw(context, 1000, np.random.default_rng(4))
    travel = travel_to_touch_m(outline(context), pushers[:, :2], directions(pushers[:, 2]), PUSHER_RADIUS_M)
    touching = travel[travel < PUSH_LENGTH_M]

    assert len(touching) == round((1.0 - OMNIPUSH_APPROACH.miss_share) * 1000)
    assert np.quantile(touching, [0.0, 0.25, 0.5, 0.75, 1.0]) == pytest.approx(
        PUSH_LENGTH_M * np.array([0.0, 0.25, 0.5, 0.75, 1.0]), abs=0.005
    )


def test_the_approach_glances_where_the_ring_does_not() -> None:
    """Lines of the approach pass up to 40 mm and more beside the centre, those of the ring within 24 mm."""
    context, furthest_m = ObjectContext.from_descriptor("4a4a4a4a"), {}
    for plan in PLANS.values():
        x, y, angle = plan.draw(context, 500, np.random.default_rng(5)).T
        furthest_m[plan.name] = float(np.quantile(np.abs(x * np.sin(angle) - y * np.cos(angle)), 0.95))

    assert furthest_m["ring"] < AIM_RADIUS_M
    assert furthest_m["approach"] > 0.040


def test_the_default_plan_has_a_folder_of_its_own() -> None:
    """The default is the approach, and no two plans share a name, a folder or a declaration."""
    assert DEFAULT_PLAN is APPROACH
    assert list(PLANS) == ["approach", "ring"]
    assert APPROACH.folder != RING.folder
    assert APPROACH.declared.keys().isdisjoint(RING.declared)
