"""Scene of a push as a MuJoCo model: the table, one object and the pusher. ``push_object`` simulates pushes in it.

The object rests on small feet on a rigid plate, so that weights shift the pressure under it. The pusher, a steel rod,
is modelled as a sphere at mid-height of the object, because the walls are vertical and the height of a line contact is
undetermined. The pusher coasts with a very large mass: the object's reaction slows it by less than 10 micrometres over
the push.
"""

import copy
from collections.abc import Callable
from typing import Final, Protocol

import mujoco
import numpy as np
from mujoco import rollout

from service.pushing.poses import PUSH_LENGTH_M
from training.simulation import exact
from training.simulation.solids import BODY_DENSITY_KG_M3, FOOT_RADIUS_M, HEIGHT_M, WEIGHT_RADIUS_M, Solid
from training.simulation.surfaces import CONTACT_FRICTION, EVEN, Array

TIME_STEP_S: Final = 0.004  # costs 0.3 mm and 9 mrad (rms), see benchmarks/time_step.py
PUSHER_RADIUS_M: Final = 0.00475
PUSHER_MASS_KG: Final = 1e5
STIFF: Final = (2 * TIME_STEP_S, 1.0)  # contact stiffness, the most that the step allows: less than 0.1 mm deep
MIDDLE_M: Final = FOOT_RADIUS_M + HEIGHT_M / 2
PUSH_DURATION_S: Final = 1.4  # of 50 mm
SEGMENT_M: Final = 0.010  # length of a push after which friction is updated to the feet's new places on the plate
_FREE, _SLIDES = 7, 2  # number of positions of the object's free joint, of the pusher's slides
_WALLS: Final = 1  # collision bit of pusher and walls. Feet touch the table by declared pairs alone

Arctangent = Callable[[Array, Array], Array]


class PushConditions(Protocol):
    """Conditions of n pushes, such as ``surfaces.Conditions``."""

    @property
    def world_poses(self) -> Array:
        """Return the object's poses on the plate before the pushes, (n, 3): x_m, y_m, yaw_rad."""

    @property
    def contact(self) -> Array:
        """Return the coefficients of friction of pusher and object, (n,)."""

    def table_friction(self, feet_m: Array) -> Array:
        """Return the friction along the world's y and x axes, (n, feet, 2), of feet at (n, feet, 2) on the plate."""


def scene(body: Solid) -> mujoco.MjSpec:
    """Return the table, the object at the origin and the pusher, not yet compiled.

    The object's free joint comes first, then the pusher's two slide joints. Pair i is foot i on the table, with its
    friction first along the world's y axis, then along x.
    """
    spec = mujoco.MjSpec()
    spec.option.timestep = TIME_STEP_S
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.worldbody.add_geom(name="table", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[1, 1, 0.1], contype=0, conaffinity=0)
    pushed = spec.worldbody.add_body(name="object")
    pushed.add_freejoint()
    _add_walls(spec, pushed, body)
    for weight in body.weights:
        pushed.add_geom(
            type=mujoco.mjtGeom.mjGEOM_CYLINDER,
            size=[WEIGHT_RADIUS_M, HEIGHT_M / 3, 0],
            pos=[weight.x_m, weight.y_m, MIDDLE_M],
            mass=weight.mass_kg,
            contype=0,
            conaffinity=0,
        )
    _add_feet(spec, pushed, body)
    _add_pusher(spec)
    return spec


def push_object(
    body: Solid,
    pushers: Array,
    conditions: PushConditions,
    pool: rollout.Rollout,
    threads: int,
    time_step_s: float = TIME_STEP_S,
    push_length_m: float = PUSH_LENGTH_M,
    arctan2: Arctangent = exact.atan2,
    pusher_radius_m: float = PUSHER_RADIUS_M,
    pusher_height_m: float = MIDDLE_M,
) -> Array:
    """Simulate pushes of one object.

    The defaults are those of the dataset. The pusher's speed is the same for all lengths.

    Args:
        body: the object.
        pushers: (n, 3) starts and directions of the pusher in the object frame: x_m, y_m, angle_rad.
        conditions: of every push.
        pool: of MuJoCo's threads.
        threads: number of them.
        time_step_s: of the simulation.
        push_length_m: of all pushes.
        arctan2: of the angles of the outcomes.
        pusher_radius_m: of its sphere.
        pusher_height_m: of the sphere's centre over the table. Near the table, no object tips over.

    Returns:
        The object's true pose after each push, in the object frame before it, (n, 3): x_m, y_m, yaw_rad.
    """
    spec = scene(body)
    spec.option.timestep = time_step_s
    spec.geom("pusher").size[0] = pusher_radius_m
    spec.body("pusher").pos[2] = pusher_height_m
    model = spec.compile()
    models = [copy.copy(model) for _ in pushers]
    rod = model.geom("pusher").id
    for each, friction in zip(models, conditions.contact, strict=True):
        each.geom_friction[rod, 0] = friction
    state = _initial_states(model, pushers, conditions.world_poses)
    feet = np.array(body.feet_m)
    datas = [mujoco.MjData(model) for _ in range(max(1, threads))]
    steps = round(PUSH_DURATION_S * push_length_m / PUSH_LENGTH_M / time_step_s)
    for segment in np.array_split(np.arange(steps), max(1, round(push_length_m / SEGMENT_M))):
        friction = conditions.table_friction(_placed(feet, _object_poses(state, arctan2)))
        for each, of_feet in zip(models, friction, strict=True):
            each.pair_friction[:, :2] = of_feet
        state = pool.rollout(models, datas, state, nstep=len(segment))[0][:, -1]
    return relative(_object_poses(state, arctan2), conditions.world_poses, arctan2)


def relative(poses: Array, frames: Array, arctan2: Arctangent = exact.atan2) -> Array:
    """Express poses (n, 3) in frames (n, 3), both given in one outer frame, with angles in [-pi, pi]."""
    (cos, sin), (dx, dy) = exact.directions(frames[:, 2]).T, (poses[:, :2] - frames[:, :2]).T
    angle = poses[:, 2] - frames[:, 2]
    turn = arctan2(exact.sin(angle), exact.cos(angle))
    return np.stack([cos * dx + sin * dy, cos * dy - sin * dx, turn], axis=1)


def _add_walls(spec: mujoco.MjSpec, pushed: mujoco.MjsBody, body: Solid) -> None:
    for number, piece in enumerate(body.pieces):
        bottom, top = (
            np.column_stack([piece, np.full(len(piece), z)]) for z in (FOOT_RADIUS_M, FOOT_RADIUS_M + HEIGHT_M)
        )
        spec.add_mesh(name=f"piece{number}", uservert=np.concatenate([bottom, top]).ravel())
        pushed.add_geom(
            type=mujoco.mjtGeom.mjGEOM_MESH,
            meshname=f"piece{number}",
            density=BODY_DENSITY_KG_M3,
            contype=_WALLS,
            conaffinity=0,
        )


def _add_feet(spec: mujoco.MjSpec, pushed: mujoco.MjsBody, body: Solid) -> None:
    for number, (x_m, y_m) in enumerate(body.feet_m):
        pushed.add_geom(
            name=f"foot{number}",
            type=mujoco.mjtGeom.mjGEOM_SPHERE,
            size=[FOOT_RADIUS_M, 0, 0],
            pos=[x_m, y_m, FOOT_RADIUS_M],
            mass=1e-4,
            contype=0,
            conaffinity=0,
        )
        level = EVEN.level[0]
        spec.add_pair(
            geomname1="table",
            geomname2=f"foot{number}",
            condim=3,
            friction=[level, level, 0, 0, 0],
            solref=STIFF,
        )


def _add_pusher(spec: mujoco.MjSpec) -> None:
    rod = spec.worldbody.add_body(name="pusher", pos=[0, 0, MIDDLE_M])
    for axis in ([1, 0, 0], [0, 1, 0]):
        rod.add_joint(type=mujoco.mjtJoint.mjJNT_SLIDE, axis=axis)
    rod.add_geom(
        name="pusher",
        type=mujoco.mjtGeom.mjGEOM_SPHERE,
        size=[PUSHER_RADIUS_M, 0, 0],
        mass=PUSHER_MASS_KG,
        friction=[CONTACT_FRICTION, 0.0, 0.0],
        priority=1,  # the contact has the pusher's friction and stiffness
        solref=STIFF,
        contype=0,
        conaffinity=_WALLS,
    )


def _placed(points: Array, poses: Array) -> Array:
    """Transform points (k, 2) of an object to each of the poses (n, 3): (n, k, 2)."""
    cos, sin = exact.cos(poses[:, 2, None]), exact.sin(poses[:, 2, None])
    x, y = points.T
    return np.asarray(poses[:, None, :2] + np.stack([cos * x - sin * y, sin * x + cos * y], axis=-1))


def _initial_states(model: mujoco.MjModel, pushers: Array, world_poses: Array) -> Array:
    """Return full physics states, (n, size): the object at rest, the pusher at its start and at full speed."""
    kind = mujoco.mjtState.mjSTATE_FULLPHYSICS
    rest = np.empty(mujoco.mj_stateSize(model, kind))
    mujoco.mj_getState(model, mujoco.MjData(model), rest, kind)
    state = np.tile(rest, (len(pushers), 1))
    positions, velocities = 1, 1 + model.nq  # offsets, after the time
    yaw, heading = world_poses[:, 2], world_poses[:, 2] + pushers[:, 2]
    state[:, positions : positions + 2] = world_poses[:, :2]
    state[:, positions + 3], state[:, positions + 6] = exact.cos(yaw / 2), exact.sin(yaw / 2)
    starts = np.concatenate(
        [_placed(start[None, :2], pose[None]) for start, pose in zip(pushers, world_poses, strict=True)]
    )
    state[:, positions + _FREE : positions + _FREE + _SLIDES] = starts[:, 0]
    speed_m_s = PUSH_LENGTH_M / PUSH_DURATION_S
    state[:, velocities + 6 : velocities + 8] = speed_m_s * exact.directions(heading)
    return state


def _object_poses(state: Array, arctan2: Arctangent) -> Array:
    """Return the object's planar poses in the world, (n, 3), from full physics states."""
    x, y, _, w, _, _, z = state[:, 1 : 1 + _FREE].T
    return np.column_stack([x, y, 2.0 * arctan2(z, w)])
