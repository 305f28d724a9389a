"""Scene of a push as a MuJoCo model: the table, one object and the pusher.

The object rests on small feet on a rigid plate, so that weights shift the pressure under it. The pusher, a steel rod,
is modelled as a sphere at mid-height of the object, because the walls are vertical and the height of a line contact is
undetermined. The pusher coasts with a very large mass: the object's reaction slows it by less than 10 micrometres over
the push.
"""

from typing import Final

import mujoco
import numpy as np

from training.simulation.solids import BODY_DENSITY_KG_M3, FOOT_RADIUS_M, HEIGHT_M, WEIGHT_RADIUS_M, Solid
from training.simulation.surfaces import CONTACT_FRICTION, EVEN

TIME_STEP_S: Final = 0.004  # costs 0.3 mm and 9 mrad (rms), see benchmarks/time_step.py
PUSHER_RADIUS_M: Final = 0.00475
PUSHER_MASS_KG: Final = 1e5
STIFF: Final = (2 * TIME_STEP_S, 1.0)  # contact stiffness, the most that the step allows: less than 0.1 mm deep
MIDDLE_M: Final = FOOT_RADIUS_M + HEIGHT_M / 2
_WALLS: Final = 1  # collision bit of pusher and walls. Feet touch the table by declared pairs alone


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
