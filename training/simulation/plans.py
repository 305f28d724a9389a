"""Named plans of pushes: simulator, starts and aims, and the noise of the tracker.

A plan's name is part of the declaration of its data, ``dataset.json``. ``RING`` is the plan of the data of before
December 2026, kept to the byte, for the tables and models that name it. ``APPROACH`` is the default.
"""

import hashlib
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Final

import mujoco
import numpy as np
from mujoco import rollout

from service.pushing.contexts import ObjectContext
from service.pushing.poses import PUSH_LENGTH_M
from service.pushing.sides import outline
from training.omnipush.layout import SIMULATED
from training.simulation import bodies, exact
from training.simulation.approach import Approach, draw_pushers
from training.simulation.pushing import STEP_M, push_body
from training.simulation.scene import PUSH_DURATION_S, PUSHER_RADIUS_M, Arctangent, push_object, scene
from training.simulation.solids import Solid, centre_of_mass_m, clearance_m, solid
from training.simulation.surfaces import Array, FrictionField, Surface, draw_conditions

START_RADIUS_M: Final = (0.0755, 0.085)  # of the pusher's start around the object's centre
AIM_RADIUS_M: Final = 0.024  # the push is aimed at a point of this disc around the object's centre
START_CLEARANCE_M: Final = 0.001
_REFERENCE_OBJECT: Final = ObjectContext.from_descriptor("1b2C3c4a")  # every shape, and both weights
# 60 % of the pushes that touch pass within 0.65 sizes of the centroid, the others anywhere over the object, so that
# distances and turns are Omnipush's recorded ones (benchmarks/omnipush_quantiles.py). A tenth of the pushes miss, which
# is enough to learn where contact ends. In the raw recordings 29 % did not move the object.
OMNIPUSH_APPROACH: Final = Approach(0.1, central_share=0.6, central_half_width=0.65, gap_shapes=(1.12, 1.06))

Pushes = Callable[[ObjectContext, int, np.random.Generator], tuple[Array, Array]]
"""Draws and simulates pushes of an object: true pusher poses (count, 3) and true outcomes (count, 3)."""


@dataclass(frozen=True)
class Plan:
    """Plan of pushes of Omnipush's objects."""

    name: str
    summary: str
    folder: Path  # of its data, by default
    simulator: str  # in the source of its data
    laboratory: Callable[[Surface, int, int], AbstractContextManager[Pushes]]
    """Opens the simulator for a surface, with a seed and a number of threads."""
    declared: Callable[[Surface], dict[str, object]]
    """Returns the entries of ``dataset.json`` of this plan alone."""
    tracker_std: tuple[float, float, float]  # of a reading of the object: m, m, rad
    arctan2: Arctangent = exact.atan2


def sample_pushers(body: Solid, count: int, rng: np.random.Generator) -> Array:
    """Draw random pusher poses from a ring around an object, (count, 3): x_m, y_m, angle_rad."""
    found = np.empty((0, 3))
    while len(found) < count:
        start = _polar(rng.uniform(*START_RADIUS_M, count), rng)
        aim = _polar(AIM_RADIUS_M * np.sqrt(rng.uniform(0.0, 1.0, count)), rng)
        towards = aim - start
        poses = np.column_stack([start, np.arctan2(towards[:, 1], towards[:, 0])])
        clearance = np.min([clearance_m(piece, start) for piece in body.pieces], axis=0)
        found = np.concatenate([found, poses[clearance > PUSHER_RADIUS_M + START_CLEARANCE_M]])
    return found[:count]


def _polar(radius: Array, rng: np.random.Generator) -> Array:
    angle = rng.uniform(-np.pi, np.pi, len(radius))
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])


@contextmanager
def _on_a_plate(surface: Surface, seed: int, threads: int) -> Iterator[Pushes]:
    """Push in MuJoCo, on one plate for all objects, as in a laboratory."""
    field = FrictionField(surface, np.random.default_rng([seed, *surface.name.encode()]))
    with rollout.Rollout(nthread=threads) as pool:

        def pushes(context: ObjectContext, count: int, rng: np.random.Generator) -> tuple[Array, Array]:
            body = solid(context)
            pushers = sample_pushers(body, count, rng)
            conditions = draw_conditions(surface, field, count, rng)
            return pushers, push_object(body, pushers, conditions, pool, threads, arctan2=np.arctan2)

        yield pushes


def push_over_the_approach(
    context: ObjectContext, surface: Surface, count: int, rng: np.random.Generator, approach: Approach
) -> tuple[Array, Array]:
    """Draw and simulate quasi-static pushes of an object, with its weight spread as on the surface.

    Returns:
        True pusher poses (count, 3) and true outcomes (count, 3).
    """
    body = _body(context, surface, rng)
    pushers = draw_pushers(body.outline, np.full(count, PUSH_LENGTH_M), PUSHER_RADIUS_M, rng, approach)
    conditions = bodies.draw_conditions(body, bodies.RECORDED, count, rng)
    return pushers[:, :3], push_body(body, pushers, PUSHER_RADIUS_M, conditions)


def _body(context: ObjectContext, surface: Surface, rng: np.random.Generator) -> bodies.Body:
    """Return an object of Omnipush with its weight spread as on the surface."""
    return bodies.body(outline(context), dict(bodies.RECORDED.plates)[surface.name], rng, centre_of_mass_m(context))


@contextmanager
def _over_the_approach(approach: Approach, surface: Surface, seed: int, threads: int) -> Iterator[Pushes]:
    del seed, threads  # objects have streams of their own, and their pushes are simulated side by side
    yield lambda context, count, rng: push_over_the_approach(context, surface, count, rng, approach)


def _ring_declaration(surface: Surface) -> dict[str, object]:
    reference = scene(solid(_REFERENCE_OBJECT))
    reference.compile()
    return {
        "simulator": f"MuJoCo {mujoco.__version__}",
        "friction_level": list(surface.level),
        "friction_spread": surface.spread,
        "friction_correlation_m": surface.correlation_m,
        "friction_grain": surface.grain,
        "push_duration_s": PUSH_DURATION_S,
        "start_radius_m": list(START_RADIUS_M),
        "aim_radius_m": AIM_RADIUS_M,
        # geometry, masses, friction and solver settings as text
        "scene_sha256": hashlib.sha256(reference.to_xml().encode()).hexdigest(),
    }


def _approach_declaration(approach: Approach, surface: Surface) -> dict[str, object]:
    body = _body(_REFERENCE_OBJECT, surface, np.random.default_rng(0))
    geometry = (body.outline.corners, body.centre_of_mass_m, body.feet_m, body.loads)
    return {
        "plan": "approach",
        "simulator": "quasi-static",
        "step_m": STEP_M,
        "physics": asdict(bodies.RECORDED),
        "approach": asdict(approach),
        "geometry_sha256": hashlib.sha256(b"".join(part.tobytes() for part in geometry)).hexdigest(),
    }


def approach_plan(approach: Approach) -> Plan:
    """Return the plan ``approach`` with some starts and aims."""
    return Plan(
        "approach",
        "quasi-static, starts between touch and 50 mm before it, glancing and missing pushes, outcomes as Omnipush's",
        SIMULATED,
        "quasi-static, plan approach",
        partial(_over_the_approach, approach),
        partial(_approach_declaration, approach),
        tracker_std=bodies.RECORDED.tracker_std,
    )


RING: Final = Plan(
    "ring",
    "MuJoCo, starts 75.5 to 85 mm from the centre, aims within 24 mm of it, the data of the tables that name no plan",
    Path("data/simulated"),
    f"MuJoCo {mujoco.__version__}",
    _on_a_plate,
    _ring_declaration,
    # Yu et al. 2016, section IV: accurate below 0.5 mm and 0.5 degrees, taken as three standard deviations
    tracker_std=(0.00017, 0.00017, 0.0029),
    arctan2=np.arctan2,  # whose last bits depend on the processor, as those of the published data
)
APPROACH: Final = approach_plan(OMNIPUSH_APPROACH)
PLANS: Final = {plan.name: plan for plan in (APPROACH, RING)}
DEFAULT_PLAN: Final = APPROACH
