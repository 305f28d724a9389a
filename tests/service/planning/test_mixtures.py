"""Distributions of importance sampling: their densities integrate to one, and their draws follow them."""

import numpy as np
import pytest

from service.planning.mixtures import Gaussian, Mixture, Student

MEAN = np.array([0.5, -1.0])
COVARIANCE = np.array([[0.5, 0.2], [0.2, 0.3]])
KINDS: dict[str, Gaussian | Mixture | Student] = {
    "gaussian": Gaussian(MEAN, COVARIANCE),
    "mixture": Mixture((Gaussian(MEAN, COVARIANCE), Gaussian(-MEAN, 0.1 * COVARIANCE)), np.array([0.7, 0.3])),
    "student": Student(MEAN, COVARIANCE, 5.0),
}


@pytest.mark.parametrize("name", KINDS)
def test_densities_integrate_to_one(name: str) -> None:
    """The sum over a fine grid, far into the tails, is one."""
    step = 0.05
    axis = np.arange(-20.0, 20.0, step)
    grid = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    assert np.exp(KINDS[name].log_density(grid)).sum() * step**2 == pytest.approx(1.0, abs=2e-3)


@pytest.mark.parametrize("name", KINDS)
def test_draws_follow_the_density(name: str) -> None:
    """The mean log density of draws is that of the density: the mean of their weights under a wide Gaussian."""
    rng = np.random.default_rng(0)
    wide = Gaussian(np.zeros(2), 9.0 * np.eye(2))
    drawn = KINDS[name].draw(40_000, rng)
    mirrored = wide.draw(400_000, rng)
    weights = np.exp(KINDS[name].log_density(mirrored) - wide.log_density(mirrored))
    expected = (weights[:, None] * mirrored).mean(axis=0)
    assert drawn.mean(axis=0) == pytest.approx(expected, abs=0.03)
    near = (np.abs(drawn - MEAN) < 0.5).all(axis=1).mean()
    assert near == pytest.approx((weights * (np.abs(mirrored - MEAN) < 0.5).all(axis=1)).mean(), abs=0.02)


def test_the_spread_of_a_mixture_counts_its_means() -> None:
    """Two narrow parts far apart have the standard deviation of their places."""
    parts = tuple(Gaussian(np.array([place]), np.array([[1e-6]])) for place in (-2.0, 2.0))
    assert Mixture(parts, np.array([0.5, 0.5])).std() == pytest.approx(np.array([2.0]), rel=1e-3)
