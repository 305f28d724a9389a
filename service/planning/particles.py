"""Particles: poses of one object that pushes move, and the moments and probabilities of a cloud of them.

A pose o that a push moves by m, given in its own frame, becomes o * m = (o_xy + R(o_yaw) m_xy, o_yaw + m_yaw).
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from service.pushing.poses import DoubleArray, wrap_angles


class Moments(NamedTuple):
    """Moments of clouds of poses."""

    mean: DoubleArray
    """(..., 3) x_m, y_m, yaw_rad. The yaw is the circular mean, in (-pi, pi]."""
    covariance: DoubleArray
    """(..., 3, 3) of x, y and yaw about that mean."""


@dataclass(frozen=True, slots=True)
class Region:
    """Region of poses: a disc around a place, and an interval around a yaw.

    Attributes:
        pose: (x_m, y_m, yaw_rad) in the middle.
        position_tolerance_m: radius of the disc.
        angle_tolerance_rad: half of the interval.
    """

    pose: tuple[float, float, float]
    position_tolerance_m: float
    angle_tolerance_rad: float

    def probability(self, poses: DoubleArray) -> DoubleArray:
        """Return the share (...) of particles (..., p, 3) that lie inside."""
        x, y, yaw = self.pose
        near = np.hypot(poses[..., 0] - x, poses[..., 1] - y) <= self.position_tolerance_m
        turned = np.abs(wrap_angles(poses[..., 2] - yaw)) <= self.angle_tolerance_rad
        share: DoubleArray = (near & turned).mean(axis=-1)
        return share


def moved(poses: DoubleArray, motions: DoubleArray) -> DoubleArray:
    """Return poses (..., 3) that moved by motions (..., 3) in their own frames, with angles in (-pi, pi]."""
    cos, sin = np.cos(poses[..., 2]), np.sin(poses[..., 2])
    x, y = motions[..., 0], motions[..., 1]
    return np.stack(
        [
            poses[..., 0] + cos * x - sin * y,
            poses[..., 1] + sin * x + cos * y,
            wrap_angles(poses[..., 2] + motions[..., 2]),
        ],
        axis=-1,
    )


def moments(poses: DoubleArray) -> Moments:
    """Return the moments of clouds of particles (..., p, 3). A single particle has no covariance."""
    yaw = np.arctan2(np.sin(poses[..., 2]).mean(axis=-1), np.cos(poses[..., 2]).mean(axis=-1))
    middle = np.concatenate([poses[..., :2].mean(axis=-2), yaw[..., None]], axis=-1)
    apart = poses - middle[..., None, :]
    apart[..., 2] = wrap_angles(apart[..., 2])
    shift = apart.mean(axis=-2)  # of the yaw, whose circular mean is near its mean
    covariance = apart.swapaxes(-1, -2) @ apart / poses.shape[-2] - shift[..., :, None] * shift[..., None, :]
    return Moments(middle, covariance)
