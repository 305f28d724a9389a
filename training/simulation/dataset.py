"""Datasets of pushes simulated in MuJoCo, recorded as Omnipush records them, in Omnipush's file format.

The object lies anywhere on the plate at any yaw. The pusher moves in a straight line at constant speed for 50 mm, and
the object does not deflect it. Pushes differ in start and aim of the pusher (``plans``) and in conditions that are not
recorded (``surfaces.Conditions``). A noisy tracker then measures the poses (``record``).

Every object has random streams of its own, so the files depend on the seed. They do not depend on the order of objects,
the number of threads, interruptions or the processor. Only the plan ``RING`` depends on the processor, in last digits.
``docs/data.md`` lists assumptions beyond the paper.
"""

import copy
import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import mujoco
import numpy as np
from mujoco import rollout
from tqdm import tqdm

from service.processors import processors
from service.pushing.contexts import ObjectContext
from service.pushing.poses import PUSH_LENGTH_M
from training.omnipush.declaration import declare_dataset
from training.omnipush.pushes import has_object, write_object
from training.simulation import exact
from training.simulation.plans import DEFAULT_PLAN, RING, Arctangent, Plan
from training.simulation.scene import TIME_STEP_S, scene
from training.simulation.solids import Solid, solid
from training.simulation.surfaces import ABS, Array, Conditions, FrictionField, Surface, draw_conditions

PUSH_DURATION_S: Final = 1.4
SEGMENT_M: Final = 0.010  # length of a push after which friction is updated to the feet's new places on the plate
# Yu et al. 2016, section IV: the robot is accurate to 0.1 mm, taken as three standard deviations
PUSHER_STD_M: Final = 0.00003
_FREE, _SLIDES = 7, 2  # number of positions of the object's free joint, of the pusher's slides


@dataclass(frozen=True)
class Simulation:
    """Dataset to simulate: objects on a surface, pushes per object, seed, and the plan of the pushes."""

    descriptors: tuple[str, ...]
    pushes_per_object: int = 250
    seed: int = 0
    surface: Surface = ABS
    plan: Plan = DEFAULT_PLAN

    def declaration(self) -> dict[str, object]:
        """Return the content of the folder's ``dataset.json``."""
        name = self.surface.name
        plan = "" if self.plan is RING else f"plan {self.plan.name}, "
        return {
            "source": f"simulated pushes (MuJoCo {mujoco.__version__}, {plan}{name.upper()}, seed {self.seed})",
            "simulated": True,
            "simulator": f"MuJoCo {mujoco.__version__}",
            "surface": name,
            "friction_level": list(self.surface.level),
            "friction_spread": self.surface.spread,
            "friction_correlation_m": self.surface.correlation_m,
            "friction_grain": self.surface.grain,
            "tracker_std": list(self.plan.tracker_std),
            "seed": self.seed,
            "pushes_per_object": self.pushes_per_object,
            "push_duration_s": PUSH_DURATION_S,
            "scene_sha256": hashlib.sha256(_reference_scene().encode()).hexdigest(),
            **self.plan.declared,
        }


def simulate_dataset(wanted: Simulation, folder: Path, threads: int | None = None, quiet: bool = False) -> int:
    """Simulate every object that the folder does not hold yet.

    Returns:
        The number of pushes simulated.

    Raises:
        DataError: The folder holds another dataset, or cannot be written.
    """
    declare_dataset(folder, wanted.declaration())
    missing = [descriptor for descriptor in wanted.descriptors if not has_object(folder, descriptor)]
    threads = threads or processors()
    surface, plan = wanted.surface, wanted.plan
    # one plate for all objects, as in a laboratory
    field = FrictionField(surface, np.random.default_rng([wanted.seed, *surface.name.encode()]))
    with rollout.Rollout(nthread=threads) as pool:
        for descriptor in tqdm(missing, desc=f"pushing on {surface.name}", unit="object", disable=quiet):
            context = ObjectContext.from_descriptor(descriptor)
            # seeded with the names' bytes, so that no other object or surface shares the stream
            rng = np.random.default_rng([wanted.seed, *f"{surface.name} {descriptor}".encode()])
            pushers = plan.draw(context, wanted.pushes_per_object, rng)
            conditions = draw_conditions(surface, field, len(pushers), rng)
            outcomes = push_object(solid(context), pushers, conditions, pool, threads, arctan2=plan.arctan2)
            write_object(folder, descriptor, *record(pushers, outcomes, rng, plan))
    return len(missing) * wanted.pushes_per_object


def push_object(
    body: Solid,
    pushers: Array,
    conditions: Conditions,
    pool: rollout.Rollout,
    threads: int,
    time_step_s: float = TIME_STEP_S,
    push_length_m: float = PUSH_LENGTH_M,
    arctan2: Arctangent = exact.atan2,
) -> Array:
    """Simulate pushes of one object.

    A length or time step other than the dataset's serves to validate the simulator. The pusher's speed stays the same.

    Returns:
        The object's true pose after each push, in the object frame before it, (n, 3): x_m, y_m, yaw_rad.
    """
    spec = scene(body)
    spec.option.timestep = time_step_s
    model = spec.compile()
    models = [copy.copy(model) for _ in pushers]
    rod = model.geom("pusher").id
    for each, friction in zip(models, conditions.contact, strict=True):
        each.geom_friction[rod, 0] = friction
    state = _initial_states(model, pushers, conditions.world_poses)
    feet = np.array(body.feet_m)
    datas = [mujoco.MjData(model) for _ in range(max(1, threads))]
    steps = round(PUSH_DURATION_S * push_length_m / PUSH_LENGTH_M / time_step_s)
    for segment in np.array_split(np.arange(steps), round(push_length_m / SEGMENT_M)):
        friction = conditions.table_friction(_placed(feet, _object_poses(state, arctan2)))
        for each, of_feet in zip(models, friction, strict=True):
            each.pair_friction[:, :2] = of_feet
        state = pool.rollout(models, datas, state, nstep=len(segment))[0][:, -1]
    return relative(_object_poses(state, arctan2), conditions.world_poses, arctan2)


def record(pushers: Array, outcomes: Array, rng: np.random.Generator, plan: Plan) -> tuple[Array, Array]:
    """Add tracker noise to pushes and outcomes, (n, 3) each, and express them in the measured object frame.

    The object's pose is measured before and after the push, so the recorded frame itself has an error.
    """
    before, after = (rng.normal(0.0, plan.tracker_std, (len(pushers), 3)) for _ in range(2))
    measured = pushers + rng.normal(0.0, 1.0, pushers.shape) * (PUSHER_STD_M, PUSHER_STD_M, 0.0)
    return relative(measured, before, plan.arctan2), relative(outcomes + after, before, plan.arctan2)


def relative(poses: Array, frames: Array, arctan2: Arctangent = exact.atan2) -> Array:
    """Express poses (n, 3) in frames (n, 3), both given in one outer frame, with angles in [-pi, pi]."""
    (cos, sin), (dx, dy) = exact.directions(frames[:, 2]).T, (poses[:, :2] - frames[:, :2]).T
    angle = poses[:, 2] - frames[:, 2]
    turn = arctan2(exact.sin(angle), exact.cos(angle))
    return np.stack([cos * dx + sin * dy, cos * dy - sin * dx, turn], axis=1)


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


def _reference_scene() -> str:
    """Return geometry, masses, friction and solver settings as text, for an object with every shape and weight."""
    spec = scene(solid(ObjectContext.from_descriptor("1b2C3c4a")))
    spec.compile()
    return str(spec.to_xml())
