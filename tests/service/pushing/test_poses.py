"""Frames: there and back, and covariances turned as matrices turn."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from service.pushing.poses import into_object_frame, into_world_frame, wrap_angle, wrap_angles

metres = st.floats(-1e3, 1e3)
angles = st.floats(-10.0, 10.0)
poses = st.tuples(metres, metres, angles)
stds = st.tuples(*[st.floats(1e-4, 1.0)] * 3)


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_many_angles_are_wrapped_as_one_is(angle_rad: float) -> None:
    """To the bit: a push alone and a push in a batch meet the model alike."""
    assert wrap_angles(np.array([angle_rad]))[0] == wrap_angle(angle_rad)


@given(poses, poses)
def test_into_the_object_frame_and_back_is_the_same_pose(pose: tuple[float, ...], frame: tuple[float, ...]) -> None:
    """One is the inverse of the other."""
    objects = np.array([frame])
    inside = into_object_frame(np.array([pose]), objects)
    back, _ = into_world_frame(inside, np.ones((1, 3)), objects)
    assert back[0, :2] == pytest.approx(pose[:2], abs=1e-9)
    assert math.cos(back[0, 2] - pose[2]) == pytest.approx(1.0)


def test_a_push_behind_a_turned_object_is_a_push_behind_it() -> None:
    """By hand: an object at (1, 2) that looks along +y is pushed from below, along +y."""
    objects = np.array([[1.0, 2.0, math.pi / 2]])
    inside = into_object_frame(np.array([[1.0, 1.925, math.pi / 2]]), objects)
    assert inside[0] == pytest.approx([-0.075, 0.0, 0.0])
    mean, covariance = into_world_frame(np.array([[0.02, 0.001, 0.1]]), np.array([[0.003, 0.001, 0.02]]), objects)
    assert mean[0] == pytest.approx([0.999, 2.02, math.pi / 2 + 0.1])
    assert covariance[0] == pytest.approx(np.diag([1e-6, 9e-6, 4e-4]))


@given(poses, stds)
def test_a_covariance_turns_as_a_matrix_does(frame: tuple[float, ...], std: tuple[float, ...]) -> None:
    """G S G^T with the turn of the frame in G; symmetric, and of the same volume."""
    _, covariance = into_world_frame(np.zeros((1, 3)), np.array([std]), np.array([frame]))
    cos, sin = math.cos(frame[2]), math.sin(frame[2])
    turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    assert covariance[0] == pytest.approx(turn @ np.diag(np.square(std)) @ turn.T, rel=1e-9, abs=1e-12)
    assert (covariance[0] == covariance[0].T).all()
