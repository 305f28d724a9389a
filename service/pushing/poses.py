"""Planar poses in SI units: frames, wrapping of angles, reach, and Gaussians in the world frame.

A **pose** is x and y in metres and an angle in radians. The **object frame** sits at the object's pose before the push:
origin at the centre of the core, x axis through the middle of side 1, y axis through the middle of side 2,
counter-clockwise positive. A **pusher pose** is the position of the pusher's tip and the direction in which it will
move. A push is that of the benchmark: straight, at constant speed, 50 mm. A **prediction** is the object's pose after
the push. Incoming angles may be any real number and are wrapped to (-pi, pi]. Outgoing angles lie in that interval.

An object pose in the world is o = (x, y, theta). A pusher pose p in the world is R(-theta) (p - o) in the object frame,
its angle less theta. A prediction m in the object frame is o + R(theta) m in the world, its angle plus theta. Its
diagonal covariance S becomes G S G^T with G = diag(R(theta), 1). Frames are changed in float64, because positions in
the world may be large against those on the object.
"""

import math
from typing import Final

import numpy as np
import numpy.typing as npt

from service.errors import FieldFault, InvalidRequestError

DoubleArray = npt.NDArray[np.float64]
PUSH_LENGTH_M: Final = 0.050
MAX_LENGTH_M: Final = 1.0
POSE_NAMES: Final = ("x", "y", "angle")
REACH_M: Final = 1.0  # a push of 50 mm from further away cannot touch the object
WORLD_M: Final = 1e6  # largest coordinate in the world, which float64 resolves to a nanometre
_TURN_RAD: Final = 2.0 * math.pi


def wrap_angle(angle_rad: float) -> float:
    """Return the same direction in (-pi, pi]."""
    if -math.pi < angle_rad <= math.pi:
        return angle_rad
    wrapped = math.remainder(angle_rad, _TURN_RAD)  # in [-pi, pi], exact
    return math.pi if wrapped == -math.pi else wrapped


def wrap_angles(angles_rad: DoubleArray) -> DoubleArray:
    """Return the same directions in (-pi, pi], exactly as ``wrap_angle`` does."""
    rest = np.fmod(angles_rad, _TURN_RAD)  # in (-2 pi, 2 pi). Both steps are exact.
    rest = np.where(rest > math.pi, rest - _TURN_RAD, rest)
    return np.where(rest <= -math.pi, rest + _TURN_RAD, rest)


def into_object_frame(poses: DoubleArray, object_poses: DoubleArray) -> DoubleArray:
    """Return poses (n, 3) of the world in the frames of objects at poses (n, 3) or (1, 3). Angles are not wrapped."""
    cos, sin = np.cos(object_poses[:, 2]), np.sin(object_poses[:, 2])
    dx, dy = poses[:, 0] - object_poses[:, 0], poses[:, 1] - object_poses[:, 1]
    return np.stack([cos * dx + sin * dy, cos * dy - sin * dx, poses[:, 2] - object_poses[:, 2]], axis=1)


def into_world_frame(mean: DoubleArray, std: DoubleArray, object_poses: DoubleArray) -> tuple[DoubleArray, DoubleArray]:
    """Return means (n, 3) and covariances (n, 3, 3) in the world, of independent Gaussians (n, 3) in object frames."""
    cos, sin = np.cos(object_poses[:, 2]), np.sin(object_poses[:, 2])
    x = object_poses[:, 0] + cos * mean[:, 0] - sin * mean[:, 1]
    y = object_poses[:, 1] + sin * mean[:, 0] + cos * mean[:, 1]
    turned = np.stack([x, y, wrap_angles(object_poses[:, 2] + mean[:, 2])], axis=1)
    vx, vy, va = np.square(std).T
    covariance = np.zeros((len(mean), 3, 3))
    covariance[:, 0, 0] = cos**2 * vx + sin**2 * vy
    covariance[:, 1, 1] = sin**2 * vx + cos**2 * vy
    covariance[:, 0, 1] = covariance[:, 1, 0] = cos * sin * (vx - vy)
    covariance[:, 2, 2] = va
    return turned, covariance


def reachable(poses: DoubleArray, where: str, limit_m: float = REACH_M) -> DoubleArray:
    """Return poses (n, 3) with wrapped angles, if every coordinate is within the limit.

    Raises:
        InvalidRequestError: a coordinate is over the limit. The message names the first.
    """
    far = np.abs(poses[:, :2]) > limit_m
    if far.any():
        row, column = (int(place) for place in np.argwhere(far)[0])
        raise InvalidRequestError([unreachable(f"{where}.{row}", float(poses[row, column]), limit_m)])
    wrapped = poses.copy()
    wrapped[:, 2] = wrap_angles(poses[:, 2])
    return wrapped


def unreachable(where: str, value_m: float, limit_m: float = REACH_M) -> FieldFault:
    """Return the fault of a coordinate that is over the limit."""
    return FieldFault(where, f"{value_m:.6g} m", f"-{limit_m:g} to {limit_m:g} m along each of the object's axes")
