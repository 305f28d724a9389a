"""Particles: composed poses, moments of clouds, and the probability of a region."""

import math

import numpy as np
import pytest

from service.planning.particles import Region, moments, moved


def test_a_motion_is_made_in_the_frame_of_the_pose() -> None:
    """An object that looks along y and moves along its own x axis moves along y."""
    found = moved(np.array([1.0, 2.0, math.pi / 2]), np.array([0.5, 0.0, 0.1]))
    assert found == pytest.approx([1.0, 2.5, math.pi / 2 + 0.1])


def test_motions_compose_as_matrices_do() -> None:
    """The pose after two motions is the product of their homogeneous matrices."""
    rng = np.random.default_rng(0)
    poses = rng.uniform(-2.0, 2.0, (3, 7, 3))
    first, second, third = poses

    def matrix(pose: np.ndarray) -> np.ndarray:
        """Return the homogeneous matrix of a pose."""
        cos, sin = math.cos(pose[2]), math.sin(pose[2])
        return np.array([[cos, -sin, pose[0]], [sin, cos, pose[1]], [0.0, 0.0, 1.0]])

    for found, *parts in zip(moved(moved(first, second), third), first, second, third, strict=True):
        assert matrix(found) == pytest.approx(matrix(parts[0]) @ matrix(parts[1]) @ matrix(parts[2]))


def test_moments_are_those_of_numpy_away_from_the_wrap() -> None:
    """A tight cloud has the mean and covariance that numpy computes."""
    rng = np.random.default_rng(1)
    cloud = rng.normal([0.3, -0.2, 1.0], [0.01, 0.02, 0.03], (2, 500, 3))
    found = moments(cloud)
    for one, mean, covariance in zip(cloud, found.mean, found.covariance, strict=True):
        assert mean == pytest.approx(one.mean(axis=0), abs=1e-6)
        assert covariance == pytest.approx(np.cov(one.T, bias=True), abs=1e-9)


def test_a_cloud_across_the_wrap_has_a_mean_there() -> None:
    """Yaws of nearly pi and nearly -pi average to pi and not to zero, and lie close together."""
    found = moments(np.array([[0.0, 0.0, math.pi - 0.1], [0.0, 0.0, 0.1 - math.pi]]))
    assert abs(found.mean[2]) == pytest.approx(math.pi)
    assert found.covariance[2, 2] == pytest.approx(0.01)


def test_a_region_counts_the_particles_inside() -> None:
    """Place and yaw must both be within tolerance, and a yaw of a whole turn more is the same."""
    region = Region((0.0, 0.0, math.pi), 0.01, 0.1)
    cloud = np.array([[0.0, 0.0, math.pi], [0.009, 0.0, -math.pi + 0.05], [0.011, 0.0, math.pi], [0.0, 0.0, 3.0]])
    assert region.probability(cloud) == 0.5
