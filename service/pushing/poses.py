"""From the world frame into the object's and back: poses, and the covariance of a prediction.

A pose of the object in the world is o = (x, y, theta). A pusher pose p in the world is R(-theta) (p - o) in the object
frame, its angle less theta. A prediction m in the object frame is o + R(theta) m in the world, its angle plus theta;
its diagonal covariance S turns into G S G^T with G = diag(R(theta), 1). All in float64: positions in the world may be
large against those on the object.
"""

import math
from dataclasses import dataclass
from typing import Final, Self

import numpy as np
import numpy.typing as npt

from service.errors import FieldFault, InvalidRequestError

DoubleArray = npt.NDArray[np.float64]
_TURN_RAD = 2.0 * math.pi


def wrap_angles(angles_rad: DoubleArray) -> DoubleArray:
    """The same directions in (-pi, pi], exactly as ``contract.wrap_angle`` wraps one."""
    rest = np.fmod(angles_rad, _TURN_RAD)  # exact, in (-2 pi, 2 pi); so is the step below
    rest = np.where(rest > math.pi, rest - _TURN_RAD, rest)
    return np.where(rest <= -math.pi, rest + _TURN_RAD, rest)


def into_object_frame(poses: DoubleArray, objects: DoubleArray) -> DoubleArray:
    """Poses (n, 3) in the world, seen from objects (n, 3) or (1, 3) in the world."""
    cos, sin = np.cos(objects[:, 2]), np.sin(objects[:, 2])
    dx, dy = poses[:, 0] - objects[:, 0], poses[:, 1] - objects[:, 1]
    return np.stack([cos * dx + sin * dy, cos * dy - sin * dx, poses[:, 2] - objects[:, 2]], axis=1)


def into_world_frame(mean: DoubleArray, std: DoubleArray, objects: DoubleArray) -> tuple[DoubleArray, DoubleArray]:
    """Means (n, 3) and covariances (n, 3, 3) in the world, of independent Gaussians (n, 3) in the frames of objects."""
    cos, sin = np.cos(objects[:, 2]), np.sin(objects[:, 2])
    x = objects[:, 0] + cos * mean[:, 0] - sin * mean[:, 1]
    y = objects[:, 1] + sin * mean[:, 0] + cos * mean[:, 1]
    turned = np.stack([x, y, wrap_angles(objects[:, 2] + mean[:, 2])], axis=1)
    vx, vy, va = np.square(std).T
    covariance = np.zeros((len(mean), 3, 3))
    covariance[:, 0, 0] = cos**2 * vx + sin**2 * vy
    covariance[:, 1, 1] = sin**2 * vx + cos**2 * vy
    covariance[:, 0, 1] = covariance[:, 1, 0] = cos * sin * (vx - vy)
    covariance[:, 2, 2] = va
    return turned, covariance


PUSH_LENGTH_M: Final = 0.050
POSE_NAMES: Final = ("x", "y", "angle")


def wrap_angle(angle_rad: float) -> float:
    """The same direction in (-pi, pi]."""
    if -math.pi < angle_rad <= math.pi:
        return angle_rad
    wrapped = math.remainder(angle_rad, 2.0 * math.pi)  # in [-pi, pi], exact
    return math.pi if wrapped == -math.pi else wrapped


@dataclass(frozen=True, slots=True)
class Pose:
    """A planar pose in the object frame: metres, metres, radians."""

    x_m: float
    y_m: float
    angle_rad: float

    @classmethod
    def wrapped(cls, x_m: float, y_m: float, angle_rad: float) -> Self:
        """The pose with its angle in (-pi, pi]."""
        return cls(x_m, y_m, wrap_angle(angle_rad))


@dataclass(frozen=True, slots=True)
class GaussianPose:
    """An independent Gaussian over the object's pose after the push: metres, metres, radians; std is positive."""

    mean: Pose
    std: Pose


REACH_M: Final = 1.0  # a push is 50 mm: further from the object nothing can touch it


def _reachable(poses: DoubleArray, where: str, most_m: float = REACH_M) -> DoubleArray:
    """The poses, angles wrapped, when all are near enough.

    Raises:
        InvalidRequestError: names the first that is not.
    """
    far = np.abs(poses[:, :2]) > most_m
    if far.any():
        row, column = (int(place) for place in np.argwhere(far)[0])
        raise InvalidRequestError([unreachable(f"{where}.{row}", float(poses[row, column]), most_m)])
    wrapped = poses.copy()
    wrapped[:, 2] = wrap_angles(poses[:, 2])
    return wrapped


def unreachable(where: str, value_m: float, most_m: float = REACH_M) -> FieldFault:
    """The fault of a push that is further out than that along an axis."""
    return FieldFault(where, f"{value_m:.6g} m", f"-{most_m:g} to {most_m:g} m along each of the object's axes")


WORLD_M: Final = 1e6  # as far as positions in the world may go: float64 keeps them to a nanometre
