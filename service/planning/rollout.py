"""Rollouts: the object's pose after each of several pushes, as clouds of particles.

The pushes are fixed in the world, so each particle meets the next push at its own pose. The model predicts each of
them, and its Gaussian is sampled. Sequences share their random numbers, so that candidates are compared by their
pushes. The moments of a cloud are its mean and covariance (moment matching).
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from service.planning.particles import Moments, moments, moved
from service.planning.push_model import PushModel, PushOutcomes
from service.pushing.poses import DoubleArray, into_object_frame, wrap_angles
from service.turns import pause

MOST_STEPS: Final = 50  # pushes of one sequence
MOST_ROWS: Final = 100_000  # pushes times particles


@dataclass(frozen=True, eq=False, slots=True)
class Rollout:
    """Poses of one object after each push of some sequences, in the world.

    Attributes:
        particles: (s, k, p, 3) x_m, y_m, yaw_rad after each of k pushes of s sequences.
        miss_probability: (s, k) share of particles that each push never touches.
        inside_probability: (s, k) share of particles that the tip starts inside of.
        unfamiliar_probability: (s, k) share of particles whose push the model does not vouch for.
    """

    particles: DoubleArray
    miss_probability: DoubleArray
    inside_probability: DoubleArray
    unfamiliar_probability: DoubleArray

    def moments(self) -> Moments:
        """Return the moments after each push: means (s, k, 3) and covariances (s, k, 3, 3)."""
        return moments(self.particles)


def rollout(model: PushModel, object_pose: DoubleArray, pushes: DoubleArray, particles: int, seed: int = 0) -> Rollout:
    """Predict sequences of pushes of one object.

    Args:
        model: of the object.
        object_pose: (3,) x_m, y_m, yaw_rad of the object in the world before each sequence, or (p, 3) particles.
        pushes: (s, k, 4) x_m, y_m, angle_rad, length_m of the pusher's tip in the world.
        particles: number p of particles of each sequence.
        seed: of the random numbers.
    """
    count, steps = pushes.shape[:2]
    rng = np.random.default_rng(seed)
    poses = np.broadcast_to(object_pose, (count, particles, 3))
    is_one = object_pose.ndim == 1  # all particles meet the first push at one pose
    found = np.empty((count, steps, particles, 3))
    misses, inside, unfamiliar = np.empty((3, count, steps))
    for step in range(steps):
        met = poses[:, :1] if step == 0 and is_one else poses
        outcomes = model(_in_object_frames(pushes[:, step], met))
        shape = met.shape[:2]
        poses = moved(poses, _motions(outcomes, shape, rng.standard_normal((particles, 3))))
        found[:, step] = poses
        misses[:, step] = outcomes.misses.reshape(shape).mean(axis=1)
        inside[:, step] = outcomes.inside.reshape(shape).mean(axis=1)
        unfamiliar[:, step] = outcomes.unfamiliar.reshape(shape).mean(axis=1)
        pause()
    return Rollout(found, misses, inside, unfamiliar)


def _motions(outcomes: PushOutcomes, shape: tuple[int, int], noise: DoubleArray) -> DoubleArray:
    """Return the motions (s, p, 3) of outcomes of (s, 1) or (s, p) rows, by noise (p, 3) that all sequences share."""
    sequences, met = shape
    if met == 1:
        return outcomes.drawn(noise[:, None]).swapaxes(0, 1)
    return outcomes.drawn(np.tile(noise, (sequences, 1))).reshape(sequences, met, 3)


def _in_object_frames(pushes: DoubleArray, poses: DoubleArray) -> DoubleArray:
    """Return pushes (s, 4) of the world in the frames of poses (s, p, 3), as rows (s * p, 4)."""
    rows = np.repeat(pushes, poses.shape[1], axis=0)
    placed = into_object_frame(rows[:, :3], poses.reshape(-1, 3))
    placed[:, 2] = wrap_angles(placed[:, 2])
    return np.column_stack([placed, rows[:, 3]])
