"""Mixtures of Gaussians: fitted to colours, beside scipy's densities."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from service.silhouettes.mixtures import SAMPLES, Mixture, fitted, sampled, squares


def two_clusters(count: int = 2000) -> np.ndarray:
    """Draw colours of two kinds, three of four of the first."""
    rng = np.random.default_rng(0)
    first = rng.normal((0.2, 0.3, 0.4), 0.02, (3 * count // 4, 3))
    second = rng.normal((0.8, 0.7, 0.2), 0.05, (count // 4, 3))
    return np.concatenate([first, second]).astype(np.float32)


def test_a_fit_finds_two_kinds_of_colours() -> None:
    """Shares, means and spreads are those that the colours were drawn with, the spreads widened by the blur."""
    mixture = fitted(two_clusters(), 2, 0.01)
    order = np.argsort(-mixture.shares)
    assert mixture.shares[order] == pytest.approx([0.75, 0.25], abs=0.02)
    assert mixture.means[order[0]] == pytest.approx([0.2, 0.3, 0.4], abs=0.01)
    assert mixture.means[order[1]] == pytest.approx([0.8, 0.7, 0.2], abs=0.02)
    assert np.sqrt(np.diag(mixture.covariances[order[0]])) == pytest.approx([0.0224] * 3, abs=0.003)


def test_the_density_is_that_of_scipy() -> None:
    """The logarithm of the density is scipy's, but for the constant of three dimensions."""
    covariance = np.array([[0.04, 0.01, 0.0], [0.01, 0.03, 0.0], [0.0, 0.0, 0.02]], dtype=np.float32)
    means = np.array([[0.1, 0.2, 0.3], [0.7, 0.6, 0.5]], dtype=np.float32)
    shares = np.array([0.3, 0.7], dtype=np.float32)
    mixture = Mixture(shares, means, np.stack([covariance, 2.0 * covariance]))
    at = np.random.default_rng(1).random((50, 3)).astype(np.float32)
    expected = np.log(
        0.3 * multivariate_normal(means[0], covariance).pdf(at)
        + 0.7 * multivariate_normal(means[1], 2.0 * covariance).pdf(at)
    )
    assert mixture.log_density(at) - 1.5 * np.log(2.0 * np.pi) == pytest.approx(expected, abs=1e-3)


@pytest.mark.parametrize("count", [1, 2, 5])
def test_equal_or_few_colours_have_a_finite_density(count: int) -> None:
    """One colour, repeated or alone, with more Gaussians than colours, gives no infinity and no division by zero."""
    alone = np.full((count, 3), 0.5, dtype=np.float32)
    density = fitted(alone, 3, 0.05).log_density(np.array([[0.5, 0.5, 0.5], [0.0, 1.0, 9.0]], dtype=np.float32))
    assert np.isfinite(density).all()
    assert density[0] > density[1]


def test_a_fit_is_the_same_each_time() -> None:
    """No randomness: two fits to the same colours are equal to the bit."""
    first, second = (fitted(two_clusters(), 3, 0.03) for _ in range(2))
    assert (first.means == second.means).all()


@pytest.mark.parametrize("count", [1, SAMPLES, SAMPLES + 1, 10 * SAMPLES - 1])
def test_a_sample_is_never_larger_than_asked(count: int) -> None:
    """At most so many colours are kept, and all of a few."""
    kept = sampled(np.zeros((count, 3), dtype=np.float32))
    assert min(count, SAMPLES // 2) <= len(kept) <= SAMPLES


def test_squares_are_mahalanobis_distances() -> None:
    """An offset of two standard deviations along an axis counts 4, in any shape of offsets."""
    covariance = np.diag([0.01, 0.04, 1.0]).astype(np.float32)
    offsets = np.array([[[0.2, 0.0, 0.0], [0.0, 0.4, 2.0]]], dtype=np.float32)
    assert squares(offsets, covariance) == pytest.approx(np.array([[4.0, 8.0]]), rel=1e-5)
