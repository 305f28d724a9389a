"""Poses: wrapped angles, reach, and frames of objects and of the world."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from service.errors import InvalidRequestError
from service.pushing.poses import into_object_frame, into_world_frame, reachable, unreachable, wrap_angle, wrap_angles

metres = st.floats(-1e3, 1e3)
angles = st.floats(-10.0, 10.0)
poses = st.tuples(metres, metres, angles)
stds = st.tuples(*[st.floats(1e-4, 1.0)] * 3)


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_a_wrapped_angle_is_the_same_direction_in_the_half_open_interval(angle: float) -> None:
    """Any finite angle is wrapped to (-pi, pi] without changing its direction."""
    wrapped = wrap_angle(angle)
    assert -math.pi < wrapped <= math.pi
    exact = math.remainder(angle, 2 * math.pi)  # the IEEE remainder is exact, whatever the size
    assert math.isclose(math.cos(wrapped), math.cos(exact), abs_tol=1e-12)
    assert math.isclose(math.sin(wrapped), math.sin(exact), abs_tol=1e-12)


@pytest.mark.parametrize(
    ("angle", "expected"),
    [(math.pi, math.pi), (-math.pi, math.pi), (3 * math.pi, math.pi), (0.5, 0.5), (2 * math.pi, 0.0)],
    ids=["pi stays", "-pi is pi", "three half turns", "inside stays", "a whole turn is none"],
)
def test_angles_at_the_border_have_one_value(angle: float, expected: float) -> None:
    """Both angles of the direction at the border, pi and -pi, become pi."""
    assert wrap_angle(angle) == pytest.approx(expected, abs=1e-15)


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_many_angles_are_wrapped_as_one_is(angle_rad: float) -> None:
    """Wrapping an array gives the same bits as wrapping each angle, so a push and a batch of pushes agree."""
    assert wrap_angles(np.array([angle_rad]))[0] == wrap_angle(angle_rad)


@given(poses, poses)
def test_into_the_object_frame_and_back_is_the_same_pose(pose: tuple[float, ...], frame: tuple[float, ...]) -> None:
    """Changing a pose into the object frame and back gives the same pose."""
    objects = np.array([frame])
    inside = into_object_frame(np.array([pose]), objects)
    back, _ = into_world_frame(inside, np.ones((1, 3)), objects)
    assert back[0, :2] == pytest.approx(pose[:2], abs=1e-9)
    assert math.cos(back[0, 2] - pose[2]) == pytest.approx(1.0)


def test_a_push_of_a_turned_object_is_computed_by_hand() -> None:
    """An object at (1, 2) whose x axis points along +y is pushed from below, along +y: from behind in its frame."""
    objects = np.array([[1.0, 2.0, math.pi / 2]])
    inside = into_object_frame(np.array([[1.0, 1.925, math.pi / 2]]), objects)
    assert inside[0] == pytest.approx([-0.075, 0.0, 0.0])
    mean, covariance = into_world_frame(np.array([[0.02, 0.001, 0.1]]), np.array([[0.003, 0.001, 0.02]]), objects)
    assert mean[0] == pytest.approx([0.999, 2.02, math.pi / 2 + 0.1])
    assert covariance[0] == pytest.approx(np.diag([1e-6, 9e-6, 4e-4]))


@given(poses, stds)
def test_a_covariance_turns_as_a_matrix_does(frame: tuple[float, ...], std: tuple[float, ...]) -> None:
    """A covariance in the world is G S G^T, with the rotation of the frame in G, and is symmetric."""
    _, covariance = into_world_frame(np.zeros((1, 3)), np.array([std]), np.array([frame]))
    cos, sin = math.cos(frame[2]), math.sin(frame[2])
    turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    assert covariance[0] == pytest.approx(turn @ np.diag(np.square(std)) @ turn.T, rel=1e-9, abs=1e-12)
    assert (covariance[0] == covariance[0].T).all()


def test_reachable_poses_are_returned_with_wrapped_angles() -> None:
    """Poses up to the limit are copied, and only their angles change."""
    given = np.array([[1.0, -1.0, 3.0 * math.pi], [0.0, 0.0, 0.5]])
    found = reachable(given, "body.pushers")
    assert found[:, :2].tolist() == [[1.0, -1.0], [0.0, 0.0]]
    assert found[:, 2] == pytest.approx([math.pi, 0.5])
    assert given[0, 2] == 3.0 * math.pi


@pytest.mark.parametrize("column", [0, 1])
def test_the_first_pose_out_of_reach_is_named(column: int) -> None:
    """A coordinate over the limit is refused with the row, its value in m and the limit."""
    poses = np.zeros((3, 3))
    poses[1:, column] = -2.5
    with pytest.raises(InvalidRequestError) as caught:
        reachable(poses, "body.pushers", 2.0)
    assert caught.value.faults == (unreachable("body.pushers.1", -2.5, 2.0),)
    assert str(caught.value).startswith("body.pushers.1: received -2.5 m; accepted is -2 to 2 m")
