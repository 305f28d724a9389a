"""Named plans: the ring as it was, and the approach with starts from touch and aims over the whole object."""

import json
import math

import numpy as np
import pytest

from service.pushing.contexts import ObjectContext
from service.pushing.poses import PUSH_LENGTH_M
from service.pushing.sides import outline
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
from training.simulation.solids import Solid, centre_of_mass_m, clearance_m, solid
from training.simulation.surfaces import ABS, Array


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


def pushes_of(plan: Plan, descriptor: str, count: int) -> tuple[Array, Array]:
    """Return true pusher poses (count, 3) and true outcomes (count, 3) of an object on ABS."""
    with plan.laboratory(ABS, 3, 1) as pushes:
        return pushes(ObjectContext.from_descriptor(descriptor), count, np.random.default_rng(3))


@pytest.mark.parametrize("plan", [pytest.param(plan, id=plan.name) for plan in PLANS.values()])
@pytest.mark.parametrize("descriptor", ["2a2B2C2c", "1a4b2c3a"])
def test_no_plan_starts_inside_an_object(plan: Plan, descriptor: str) -> None:
    """Every start is clear of every piece by more than the tip, and every push has an outcome."""
    pushers, outcomes = pushes_of(plan, descriptor, 60)
    clearance = np.min([clearance_m(piece, pushers[:, :2]) for piece in body_of(descriptor).pieces], axis=0)

    assert pushers.shape == outcomes.shape == (60, 3)
    assert (clearance > PUSHER_RADIUS_M).all()
    assert (np.abs(pushers[:, 2]) <= math.pi).all()
    assert np.isfinite(outcomes).all()


def test_the_approach_has_its_share_of_misses_and_starts_from_touch_to_a_length_away() -> None:
    """The set share of the pushes never touches nor moves the object, and the gaps of the others fill the length."""
    pushers, outcomes = pushes_of(APPROACH, "1a2b3c4a", 1000)
    shape = outline(ObjectContext.from_descriptor("1a2b3c4a"))
    travel = travel_to_touch_m(shape, pushers[:, :2], directions(pushers[:, 2]), PUSHER_RADIUS_M)
    touching = travel < PUSH_LENGTH_M

    assert touching.sum() == round((1.0 - OMNIPUSH_APPROACH.miss_share) * 1000)
    assert np.quantile(travel[touching], [0.0, 0.25, 0.5, 0.75, 1.0]) == pytest.approx(
        PUSH_LENGTH_M * np.array([0.0, 0.25, 0.5, 0.75, 1.0]), abs=0.005
    )
    # an object lies up to 2 mm beside its tracked place, so a push that passes that near may touch it
    assert np.mean(np.abs(outcomes[~touching]).max(axis=1) > 0.001) < 0.1


def test_the_approach_glances_where_the_ring_does_not() -> None:
    """Lines of the approach pass 40 mm and more beside the centre, those of the ring within 24 mm."""
    furthest_m = {}
    for plan in PLANS.values():
        x, y, angle = pushes_of(plan, "4a4a4a4a", 60)[0].T
        furthest_m[plan.name] = float(np.quantile(np.abs(x * np.sin(angle) - y * np.cos(angle)), 0.9))

    assert furthest_m["ring"] < AIM_RADIUS_M
    assert furthest_m["approach"] > 0.035


def test_a_heavy_side_lags_behind() -> None:
    """The centre of mass of the default plan's objects lies on the side with the weight, further for a heavier one."""
    places = [centre_of_mass_m(ObjectContext.from_descriptor(name)) for name in ("3a2a3a2a", "3a2b3a2a", "3a2C3a2a")]

    assert places[0] == pytest.approx([0.0, 0.0], abs=1e-9)
    assert 0.005 < places[1][1] < places[2][1] < 0.03
    assert [abs(float(place[0])) < 1e-9 for place in places] == [True] * 3


def test_the_default_plan_has_a_folder_of_its_own() -> None:
    """The default is the approach, and no two plans share a name, a folder or a simulator."""
    assert DEFAULT_PLAN is APPROACH
    assert list(PLANS) == ["approach", "ring"]
    assert APPROACH.folder != RING.folder
    assert APPROACH.simulator != RING.simulator


def test_a_plan_declares_its_settings_as_plain_values() -> None:
    """The declaration names plan, settings and physical constants, and survives JSON."""
    declared = json.loads(json.dumps(APPROACH.declared(ABS)))

    assert declared["plan"] == "approach"
    assert declared["approach"]["miss_share"] == OMNIPUSH_APPROACH.miss_share
    assert declared["physics"]["contact"] > 0.0
    assert "scene_sha256" in RING.declared(ABS)
