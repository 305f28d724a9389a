"""Pushes in MuJoCo, written in Omnipush's own file format.

The object rests on small feet on a table with Coulomb friction; the pusher, a steel rod, moves in a straight line at
constant speed for 50 mm and does not feel the object. Both start where ``sample_pushers`` says, and the object's pose
at the end of the push is the outcome. Nothing is random but the sampled pushes, and every object has its own random
stream, so that the files depend on the seed alone: not on the order, on the number of threads, or on interruptions.

Assumptions beyond the paper: friction, speed and geometry are listed in ``docs/data.md``. The rod is
a sphere at mid-height of the object, since the walls are vertical and a line contact's height is undetermined. Its
mass is so large that it coasts: the object's push-back slows it by less than 10 micrometres over the push.
"""

import hashlib
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import mujoco
import numpy as np
import numpy.typing as npt
from mujoco import rollout
from tqdm import tqdm

from service.contract import PUSH_LENGTH_M, ObjectContext
from training import data
from training.objects import BODY_DENSITY_KG_M3, FOOT_RADIUS_M, HEIGHT_M, WEIGHT_RADIUS_M, Solid, clearance_m, solid

Array = npt.NDArray[np.float64]

PUSH_DURATION_S: Final = 1.4
TIME_STEP_S: Final = 0.004  # costs 0.2 mm and 7 mrad (rms), see benchmarks/time_step.py
PUSHER_RADIUS_M: Final = 0.00475
PUSHER_MASS_KG: Final = 1e5
FRICTION: Final = 0.25
START_RADIUS_M: Final = (0.075, 0.084)  # of the pusher's start around the object's centre
AIM_RADIUS_M: Final = 0.025  # the push is aimed at a point of this disc around the object's centre
START_CLEARANCE_M: Final = 0.001
# A push that moved the object by less than both has missed it.
CONTACT_DISPLACEMENT_M: Final = 0.0005
CONTACT_TURN_RAD: Final = 0.003
_TABLE, _WALLS = 1, 2  # collision bits: feet meet the table, the pusher meets the walls


@dataclass(frozen=True)
class SimulationPlan:
    """What to simulate: objects, pushes of each, the seed of it all."""

    descriptors: tuple[str, ...]
    pushes_per_object: int = 250
    seed: int = 0

    def declaration(self) -> dict[str, object]:
        """What ``dataset.json`` says of the folder."""
        return {
            "source": f"simulated pushes (MuJoCo {mujoco.__version__}, ABS, seed {self.seed})",
            "simulated": True,
            "simulator": f"MuJoCo {mujoco.__version__}",
            "surface": "abs",
            "seed": self.seed,
            "pushes_per_object": self.pushes_per_object,
            "push_duration_s": PUSH_DURATION_S,
            "start_radius_m": list(START_RADIUS_M),
            "aim_radius_m": AIM_RADIUS_M,
            "scene_sha256": hashlib.sha256(_reference_scene().encode()).hexdigest(),
        }


def simulate_dataset(plan: SimulationPlan, folder: Path, threads: int | None = None, quiet: bool = False) -> None:
    """Simulate every object that the folder does not hold yet.

    Raises:
        DataError: the folder holds another dataset.
    """
    data.declare_dataset(folder, plan.declaration())
    missing = [descriptor for descriptor in plan.descriptors if not data.has_object(folder, descriptor)]
    threads = threads or os.cpu_count() or 1
    with rollout.Rollout(nthread=threads) as pool:
        for descriptor in tqdm(missing, desc="simulating", unit="object", disable=quiet):
            context = ObjectContext.from_descriptor(descriptor)
            # the descriptor's bytes make a stream that no other object shares
            rng = np.random.default_rng([plan.seed, *descriptor.encode()])
            pushers = sample_pushers(solid(context), plan.pushes_per_object, rng)
            data.write_object(folder, descriptor, pushers, push_object(solid(context), pushers, pool, threads))


def sample_pushers(body: Solid, count: int, rng: np.random.Generator) -> Array:
    """Random pusher poses around an object, none of them touching it; (count, 3), x_m, y_m, angle_rad."""
    found = np.empty((0, 3))
    while len(found) < count:
        start = _polar(rng.uniform(*START_RADIUS_M, count), rng)
        aim = _polar(AIM_RADIUS_M * np.sqrt(rng.uniform(0.0, 1.0, count)), rng)
        towards = aim - start
        poses = np.column_stack([start, np.arctan2(towards[:, 1], towards[:, 0])])
        clearance = np.min([clearance_m(piece, start) for piece in body.pieces], axis=0)
        found = np.concatenate([found, poses[clearance > PUSHER_RADIUS_M + START_CLEARANCE_M]])
    return found[:count]


def push_object(
    body: Solid, pushers: Array, pool: rollout.Rollout, threads: int, time_step_s: float = TIME_STEP_S
) -> Array:
    """The object's pose after each push, in the object frame; (n, 3), x_m, y_m, yaw_rad."""
    spec = scene(body)
    spec.option.timestep = time_step_s
    model = spec.compile()
    start = mujoco.MjData(model)
    speed_m_s = PUSH_LENGTH_M / PUSH_DURATION_S
    direction = np.column_stack([np.cos(pushers[:, 2]), np.sin(pushers[:, 2])])
    state = np.tile(_full_state(model, start), (len(pushers), 1))
    positions, velocities = 1, 1 + model.nq  # after the time
    state[:, positions + 7 : positions + 9] = pushers[:, :2]  # behind the object's free joint
    state[:, velocities + 6 : velocities + 8] = speed_m_s * direction
    datas = [mujoco.MjData(model) for _ in range(max(1, threads))]
    steps = round(PUSH_DURATION_S / time_step_s)
    states, _ = pool.rollout(model, datas, state, nstep=steps)
    x_y = states[:, -1, positions : positions + 2]
    w, _, _, z = states[:, -1, positions + 3 : positions + 7].T
    yaw = 2.0 * np.arctan2(z, w)
    return np.column_stack([x_y, np.arctan2(np.sin(yaw), np.cos(yaw))])


def scene(body: Solid) -> mujoco.MjSpec:
    """The table, the object at the origin and the pusher as a MuJoCo model, not yet compiled."""
    spec = mujoco.MjSpec()
    spec.option.timestep = TIME_STEP_S
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    friction = [FRICTION, 0.0, 0.0]
    spec.worldbody.add_geom(
        type=mujoco.mjtGeom.mjGEOM_PLANE, size=[1, 1, 0.1], friction=friction, contype=_TABLE, conaffinity=0
    )
    thing = spec.worldbody.add_body(name="object")
    thing.add_freejoint()
    for number, piece in enumerate(body.pieces):
        bottom, top = (
            np.column_stack([piece, np.full(len(piece), z)]) for z in (FOOT_RADIUS_M, FOOT_RADIUS_M + HEIGHT_M)
        )
        spec.add_mesh(name=f"piece{number}", uservert=np.concatenate([bottom, top]).ravel())
        thing.add_geom(
            type=mujoco.mjtGeom.mjGEOM_MESH,
            meshname=f"piece{number}",
            density=BODY_DENSITY_KG_M3,
            friction=friction,
            contype=_WALLS,
            conaffinity=0,
        )
    middle_m = FOOT_RADIUS_M + HEIGHT_M / 2
    for weight in body.weights:
        thing.add_geom(
            type=mujoco.mjtGeom.mjGEOM_CYLINDER,
            size=[WEIGHT_RADIUS_M, HEIGHT_M / 3, 0],
            pos=[weight.x_m, weight.y_m, middle_m],
            mass=weight.mass_kg,
            contype=0,
            conaffinity=0,
        )
    for x_m, y_m in body.feet_m:
        thing.add_geom(
            type=mujoco.mjtGeom.mjGEOM_SPHERE,
            size=[FOOT_RADIUS_M, 0, 0],
            pos=[x_m, y_m, FOOT_RADIUS_M],
            mass=1e-4,
            friction=friction,
            contype=0,
            conaffinity=_TABLE,
        )
    rod = spec.worldbody.add_body(name="pusher", pos=[0, 0, middle_m])
    for axis in ([1, 0, 0], [0, 1, 0]):
        rod.add_joint(type=mujoco.mjtJoint.mjJNT_SLIDE, axis=axis)
    rod.add_geom(
        type=mujoco.mjtGeom.mjGEOM_SPHERE,
        size=[PUSHER_RADIUS_M, 0, 0],
        mass=PUSHER_MASS_KG,
        friction=friction,
        contype=0,
        conaffinity=_WALLS,
    )
    return spec


def missed_share(outcomes: npt.NDArray[np.floating[Any]]) -> float:
    """Share of pushes that did not move the object; outcomes (..., 3)."""
    still = np.hypot(outcomes[..., 0], outcomes[..., 1]) < CONTACT_DISPLACEMENT_M
    return float(np.mean(still & (np.abs(outcomes[..., 2]) < CONTACT_TURN_RAD)))


def likeness(pushes: data.Pushes) -> Sequence[tuple[str, float, float, float, float]]:
    """Beside the published statistics: (quantity, mean here, published mean, std here, published std), SI units."""
    published = data.published_normalisation()
    present = pushes.valid > 0
    rows: list[tuple[str, float, float, float, float]] = []
    for label, values, mean, std in (
        ("pusher", pushes.pushers[present], published.input_mean, published.input_std),
        ("object", pushes.outcomes[present], published.output_mean, published.output_std),
    ):
        for column, name in enumerate(("x_m", "y_m", "angle_rad")):
            here = values[:, column].astype(np.float64)
            rows.append((f"{label} {name}", float(here.mean()), mean[column], float(here.std()), std[column]))
    return rows


def _polar(radius: Array, rng: np.random.Generator) -> Array:
    angle = rng.uniform(-np.pi, np.pi, len(radius))
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])


def _full_state(model: mujoco.MjModel, start: mujoco.MjData) -> Array:
    kind = mujoco.mjtState.mjSTATE_FULLPHYSICS
    state = np.empty(mujoco.mj_stateSize(model, kind))
    mujoco.mj_getState(model, start, state, kind)
    return state


def _reference_scene() -> str:
    """Geometry, masses, friction and solver settings as text, for an object with every shape and weight."""
    spec = scene(solid(ObjectContext.from_descriptor("1b2C3c4a")))
    spec.compile()
    return str(spec.to_xml())
