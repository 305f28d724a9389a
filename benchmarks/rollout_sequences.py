"""Sequences of pushes with the true pose after each: simulated in MuJoCo, or chained from recorded pushes.

**Simulated.** A drawn object lies on a table in MuJoCo (``training.environments.tabletop``), with its own pressure, and
with new friction under each push. Each push is drawn about the object at one particle of the rollout so far. So all
are fixed in the world before the first is made, as in a plan. A push that starts inside of the object for more than a
hundredth of the particles is drawn anew. A sequence with a push that starts inside of the true object is left out.

**Chained.** Recorded pushes stand alone: each begins with the object at the origin of its own frame. A chain takes
different pushes of one object on one surface, at random. Its pose after each is the composition of their outcomes, as
if the plate were alike everywhere. Its first pose is the origin. Each push lies in the world as it lay to the object,
placed at the true pose before it. So the tip starts in touch with the true object, which the rollout is not told: its
particles meet the push off their own poses.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np

from service.planning.particles import moved
from service.planning.push_model import PushModel
from service.planning.rollout import rollout
from service.pushing.outlines import Outline
from service.pushing.poses import DoubleArray, into_object_frame
from service.pushing.shape_context import ShapeContext
from training.environments.tasks import Task
from training.simulation.approach import Approach, draw_pushers
from training.simulation.exact import exp
from training.tables.push_table import IndexArray, PushTable

LENGTHS_M: Final = (0.02, 0.10)  # of simulated pushes, even in their logarithm
CLEAR: Final = 0.01  # share of particles in which a planned push may start inside of the object
PLANNING_PARTICLES: Final = 64
_TRIES: Final = 50
_TOUCHING: Final = Approach(miss_share=0.0)


@dataclass(frozen=True, eq=False)
class Sequences:
    """Sequences of k pushes of one object, and the truth.

    Attributes:
        context: of the object, as the model is told.
        start: (3,) pose in the world before the first push.
        pushes: (s, k, 4) x_m, y_m, angle_rad, length_m in the world.
        poses: (s, k, 3) x_m, y_m, yaw_rad after each push.
    """

    context: ShapeContext
    start: DoubleArray
    pushes: DoubleArray
    poses: DoubleArray


def simulated(task: Task, context: ShapeContext, model: PushModel, steps: int) -> Sequences | None:
    """Plan and simulate one sequence, or return None if a push starts inside of the true object."""
    rng = np.random.default_rng([task.seed, 1])
    table = task.tabletop()
    pushes, poses = np.empty((steps, 4)), np.empty((steps, 3))
    cloud = np.tile(task.start, (PLANNING_PARTICLES, 1))
    for step in range(steps):
        push = _planned(task.drawn.outline, task.drawn.pusher_radius_m, cloud, rng)
        if table.depth_m(push) > 0.0:
            return None
        pushes[step], poses[step] = push, table.push(push)
        cloud = rollout(model, cloud, push[None, None], PLANNING_PARTICLES, step).particles[0, 0]
    return Sequences(context, task.start, pushes[None], poses[None])


def chained(table: PushTable, count: int, steps: int, seed: int) -> Iterator[Sequences]:
    """Yield chains of recorded pushes, ``count`` in all, spread evenly over the pairs of an object and a surface.

    A pair with fewer pushes than a chain has is left out. The model is told what the table has of the object.
    """
    pairs = np.unique(np.stack([table.object_index, table.surface_index], axis=1), axis=0)
    rng = np.random.default_rng([seed, 2])
    for number, (item, surface) in enumerate(pairs.tolist()):
        rows = np.flatnonzero((table.object_index == item) & (table.surface_index == surface))
        share = count // len(pairs) + (number < count % len(pairs))
        if share and len(rows) >= steps:
            known = table.objects[item]
            radius_m = float(table.pusher_radius_m[rows[0]])
            context = ShapeContext(known.outline, known.centre_of_mass_m, known.friction, radius_m)
            yield _chains(table, np.array([rng.choice(rows, steps, replace=False) for _ in range(share)]), context)


def _chains(table: PushTable, taken: IndexArray, context: ShapeContext) -> Sequences:
    """Return the chains of some rows (s, k) of a table."""
    pose = np.zeros((len(taken), 3))
    pushes, poses = np.empty((*taken.shape, 4)), np.empty((*taken.shape, 3))
    for step, rows in enumerate(taken.T):
        pushes[:, step, :3] = moved(pose, table.pushers[rows, :3])
        pushes[:, step, 3] = table.pushers[rows, 3]
        pose = moved(pose, table.outcomes[rows])
        poses[:, step] = pose
    return Sequences(context, np.zeros(3), pushes, poses)


def _planned(outline: Outline, radius_m: float, cloud: DoubleArray, rng: np.random.Generator) -> DoubleArray:
    """Return a push (4,) in the world about one of the particles (p, 3), clear of nearly all."""
    low, high = np.log(LENGTHS_M)
    for _ in range(_TRIES):
        length_m = exp(rng.uniform(low, high, 1))
        (pusher,) = draw_pushers(outline, length_m, radius_m, rng, _TOUCHING)
        push = np.append(moved(cloud[rng.integers(len(cloud))], pusher[:3]), length_m)
        starts = into_object_frame(np.broadcast_to(push[:3], cloud.shape), cloud)[:, :2]
        if (outline.distance_m(starts) < 0.0).mean() <= CLEAR:
            break
    return push
