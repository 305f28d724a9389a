"""The scene in MuJoCo: pushes that obey mechanics."""

import math
from dataclasses import replace

import mujoco
import numpy as np
import numpy.typing as npt
import pytest
from mujoco import rollout

from service.pushing.contexts import ObjectContext
from service.pushing.poses import PUSH_LENGTH_M
from service.pushing.sides import CIRCLE_RADIUS_M, CORE_HALF_WIDTH_M
from training.inspection.statistics import missed
from training.simulation.plans import sample_pushers
from training.simulation.scene import PUSH_DURATION_S, PUSHER_RADIUS_M, push_object, relative, scene
from training.simulation.solids import Solid, solid
from training.simulation.surfaces import (
    ABS,
    PLYWOOD,
    Array,
    Conditions,
    FrictionField,
    draw_conditions,
    even_conditions,
)

# Symmetric scenes differ by rounding only (1e-16 relative), which 350 steps of contact and a solver that stops at 1e-8
# may amplify. 10 micrometres and 0.1 mrad leave them room and are a hundredth of the time step's own error.
SAME_M_AND_RAD = np.array([1e-5, 1e-5, 1e-4])


def body_of(descriptor: str) -> Solid:
    """Return the solid of a descriptor."""
    return solid(ObjectContext.from_descriptor(descriptor))


def push(descriptor: str, pushers: npt.ArrayLike, conditions: Conditions | None = None) -> Array:
    """Return the true outcomes of pushes on one thread, on an even table by default."""
    poses = np.array(pushers, dtype=np.float64)
    with rollout.Rollout(nthread=1) as pool:
        return push_object(body_of(descriptor), poses, conditions or even_conditions(len(poses)), pool, 1)


def some_pushers(descriptor: str, count: int) -> Array:
    """Return random pusher poses, the same for the same object."""
    return sample_pushers(body_of(descriptor), count, np.random.default_rng(5))


@pytest.mark.parametrize(
    "bearing", [math.pi, -math.pi / 2, math.pi / 2, 0.0], ids=["along +x", "along +y", "along -y", "along -x"]
)
def test_a_symmetric_object_pushed_through_its_centre_goes_straight(bearing: float) -> None:
    """The object moves by the push minus the gap to its wall, neither sideways nor turning."""
    start = 0.080 * np.array([math.cos(bearing), math.sin(bearing)])
    (outcome,) = push("3a3a3a3a", [(*start, bearing + math.pi)])

    along = -outcome[:2] @ start / 0.080
    aside = (outcome[1] * start[0] - outcome[0] * start[1]) / 0.080
    gap_m = 0.080 - (CORE_HALF_WIDTH_M + CIRCLE_RADIUS_M) - PUSHER_RADIUS_M
    # the half disc's 24 corners leave its front 0.07 mm flatter, the contact is softer than steel by about as much
    assert along == pytest.approx(PUSH_LENGTH_M - gap_m, abs=0.0002)
    assert abs(aside) < 1e-6
    assert abs(outcome[2]) < 1e-6


def test_a_mirrored_push_of_a_mirrored_object_has_a_mirrored_outcome() -> None:
    """Swapping sides 2 and 4 and the signs of y and angle of a push changes the signs of y and yaw of the outcome."""
    pushers = some_pushers("1a2B3c4b", 12)
    mirror = np.array([1.0, -1.0, -1.0])

    expected = push("1a2B3c4b", pushers)
    found = push("1a4b3c2B", pushers * mirror) * mirror
    assert (np.abs(found - expected) < SAME_M_AND_RAD).all()
    assert (np.abs(expected).max(axis=0) > 0.005).all()


@pytest.mark.parametrize("quarter_turns", [1, 2, 3], ids=["quarter turn", "half turn", "three quarters"])
def test_a_turned_push_of_a_turned_object_has_a_turned_outcome(quarter_turns: int) -> None:
    """Mechanics does not depend on the direction of the object frame."""
    context = ObjectContext.from_descriptor("1a2C3b4a")
    pushers = some_pushers("1a2C3b4a", 8)
    angle = quarter_turns * math.pi / 2
    turn = np.array([(math.cos(angle), -math.sin(angle)), (math.sin(angle), math.cos(angle))])

    expected = push("1a2C3b4a", pushers)
    found = push(
        context.turned(quarter_turns).descriptor(), np.column_stack([pushers[:, :2] @ turn.T, pushers[:, 2] + angle])
    )
    assert (np.abs(np.column_stack([found[:, :2] @ turn, found[:, 2]]) - expected) < SAME_M_AND_RAD).all()


def test_a_heavy_side_lags_behind() -> None:
    """An object pushed through its centre turns around its heavy side, more if it is heavier or further out."""
    along_x = [(-0.080, 0.0, 0.0)]
    turns = [float(push(descriptor, along_x)[0, 2]) for descriptor in ("3a2a3a2a", "3a2b3a2a", "3a2c3a2a", "3a2C3a2a")]

    assert turns[0] == pytest.approx(0.0, abs=1e-6)
    assert turns == sorted(turns)
    assert np.diff(turns).min() > 0.01


def test_the_outcome_does_not_depend_on_the_place_on_an_even_table() -> None:
    """Without grain and patches the object's place and yaw in the world do not change the outcome in its own frame."""
    pushers = some_pushers("1a2B3c4b", 8)
    lying = np.column_stack([np.linspace(-0.1, 0.1, 8), np.linspace(0.1, -0.05, 8), np.linspace(-3.0, 3.0, 8)])

    moved = push("1a2B3c4b", pushers, replace(even_conditions(8), world_poses=lying))
    assert (np.abs(moved - push("1a2B3c4b", pushers)) < SAME_M_AND_RAD).all()


def test_the_grain_of_wood_holds_more_across_than_along() -> None:
    """A push at 45 degrees to the grain drags the object along the grain rather than across it.

    The object is round, so that the force of the contact acts through its centre, apart from the pusher's friction.
    """
    lying = np.array([(0.0, 0.0, yaw) for yaw in (0.0, math.pi / 4, -math.pi / 4)])
    rough = replace(PLYWOOD, spread=0.0, grain=3.0)
    conditions = replace(even_conditions(3), surface=rough, world_poses=lying, table_level=np.full(3, 0.26))
    plain, left, right = push("3a3a3a3a", [(-0.080, 0.0, 0.0)] * 3, conditions)

    assert abs(plain[1]) < 1e-4
    # turned by +45 degrees, the grain runs at -45 degrees in the object's frame
    assert left[1] < -0.0005
    assert right[1] == pytest.approx(-left[1], abs=1e-4)


def test_the_same_push_on_a_real_table_has_outcomes_that_scatter() -> None:
    """A repeated push scatters on patches of friction, on plywood more than on ABS, and not at all on an even table."""
    spread = {}
    for surface in (ABS, PLYWOOD):
        rng = np.random.default_rng(3)
        conditions = draw_conditions(surface, FrictionField(surface, rng), 40, rng)
        outcomes = push("4a4a4a4a", [(-0.075, 0.015, 0.0)] * 40, conditions)
        spread[surface.name] = outcomes.std(axis=0)
    even = push("4a4a4a4a", [(-0.075, 0.015, 0.0)] * 2)

    assert (even[0] == even[1]).all()
    assert 0.005 < spread["abs"][2] < 0.1
    assert (spread["plywood"] > spread["abs"]).all()


def test_contacts_are_shallow_and_slow() -> None:
    """At every step bodies overlap by less than 0.2 mm, and the object stays flat and hardly faster than the pusher."""
    model = scene(body_of("1b2C3c4a")).compile()
    state = mujoco.MjData(model)
    state.qpos[7:9] = (-0.080, 0.005)
    state.qvel[6:8] = (PUSH_LENGTH_M / PUSH_DURATION_S, 0.0)
    deepest_m = fastest_m_s = highest_m = 0.0
    for _ in range(round(PUSH_DURATION_S / model.opt.timestep)):
        mujoco.mj_step(model, state)
        deepest_m = min(deepest_m, *(float(contact.dist) for contact in state.contact), 0.0)
        fastest_m_s = max(fastest_m_s, float(np.linalg.norm(state.qvel[:2])))
        highest_m = max(highest_m, abs(float(state.qpos[2])))

    assert deepest_m > -0.0002
    assert fastest_m_s < 2.0 * PUSH_LENGTH_M / PUSH_DURATION_S
    assert highest_m < 0.0005
    assert abs(float(state.qpos[4])) < 1e-3  # no tilt
    assert abs(float(state.qpos[5])) < 1e-3


def test_a_pose_in_its_own_frame_is_the_origin() -> None:
    """A pose is the origin of its own frame, and angles are wrapped for a frame turned several times."""
    poses = np.array([(1.0, 2.0, 3.0), (0.0, 1.0, 0.5)])
    frames = np.array([(1.0, 2.0, 3.0), (0.0, 0.0, math.pi / 2 - 4 * math.pi)])

    assert relative(poses, frames) == pytest.approx(np.array([(0.0, 0.0, 0.0), (1.0, 0.0, 0.5 - math.pi / 2)]))


def test_every_outcome_belongs_to_its_push() -> None:
    """Pushes in another order have their outcomes in that order, to the bit."""
    pushers = some_pushers("1a2b3c4a", 5)
    order = [3, 0, 4, 2, 1]

    assert (push("1a2b3c4a", pushers[order]) == push("1a2b3c4a", pushers)[order]).all()


def test_a_push_that_misses_leaves_the_object() -> None:
    """A push away from the object or past it does not move it and counts as missed, and a hit does not."""
    outcomes = push("1a2b3c4a", [(-0.080, 0.0, math.pi), (0.0, 0.090, 0.0), (-0.080, 0.0, 0.0), (-0.080, 0.01, 0.0)])

    assert (np.abs(outcomes[:2]) < 1e-5).all()
    assert (np.hypot(outcomes[2:, 0], outcomes[2:, 1]) > 0.005).all()
    assert missed(outcomes).tolist() == [True, True, False, False]
