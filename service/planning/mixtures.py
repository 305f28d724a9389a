"""Distributions of importance sampling: Gaussians and their mixtures, and the Student distribution."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from service.pushing.poses import DoubleArray


@dataclass(frozen=True, eq=False)
class Gaussian:
    """Gaussian with a mean (d,) and a covariance (d, d)."""

    mean: DoubleArray
    covariance: DoubleArray

    @cached_property
    def root(self) -> DoubleArray:
        """Return the lower Cholesky factor (d, d) of the covariance."""
        root: DoubleArray = np.linalg.cholesky(self.covariance).astype(np.float64)
        return root

    def squares(self, places: DoubleArray) -> DoubleArray:
        """Return the squared Mahalanobis distances (n,) of places (n, d)."""
        scaled = np.linalg.solve(self.root, (places - self.mean).T)
        squares: DoubleArray = (scaled**2).sum(axis=0)
        return squares

    def log_density(self, places: DoubleArray) -> DoubleArray:
        """Return the log density (n,) at places (n, d)."""
        return -0.5 * (self.squares(places) + len(self.mean) * math.log(2.0 * math.pi)) - self.log_volume()

    def log_volume(self) -> float:
        """Return the logarithm of the determinant of ``root``."""
        return float(np.log(np.diagonal(self.root)).sum())

    def draw(self, count: int, rng: np.random.Generator) -> DoubleArray:
        """Draw places (n, d)."""
        return self.mean + rng.standard_normal((count, len(self.mean))) @ self.root.T


@dataclass(frozen=True, eq=False)
class Mixture:
    """Mixture of Gaussians with weights (c,)."""

    parts: Sequence[Gaussian]
    weights: DoubleArray

    def log_density(self, places: DoubleArray) -> DoubleArray:
        """Return the log density (n,) at places (n, d)."""
        terms = [
            math.log(weight) + part.log_density(places)
            for part, weight in zip(self.parts, self.weights.tolist(), strict=True)
        ]
        found: DoubleArray = np.logaddexp.reduce(terms, axis=0)
        return found

    def draw(self, count: int, rng: np.random.Generator) -> DoubleArray:
        """Draw places (n, d)."""
        which = rng.choice(len(self.parts), count, p=self.weights)
        return np.stack([part.draw(count, rng) for part in self.parts])[which, np.arange(count)]

    def std(self) -> DoubleArray:
        """Return the standard deviations (d,)."""
        means = np.array([part.mean for part in self.parts])
        variances = np.array([np.diagonal(part.covariance) for part in self.parts])
        mean = self.weights @ means
        return np.asarray(np.sqrt(self.weights @ (variances + (means - mean) ** 2)))


@dataclass(frozen=True, eq=False)
class Student:
    """Student distribution about a mean (d,), with a scale matrix (d, d) and degrees of freedom."""

    mean: DoubleArray
    scale: DoubleArray
    freedom: float

    @cached_property
    def _gaussian(self) -> Gaussian:
        return Gaussian(self.mean, self.scale)

    def log_density(self, places: DoubleArray) -> DoubleArray:
        """Return the log density (n,) at places (n, d)."""
        squares, dimensions = self._gaussian.squares(places), len(self.mean)
        return _student(squares, dimensions, self.freedom) - self._gaussian.log_volume()

    def draw(self, count: int, rng: np.random.Generator) -> DoubleArray:
        """Draw places (n, d)."""
        spread = np.sqrt(self.freedom / rng.chisquare(self.freedom, (count, 1)))
        return self.mean + (self._gaussian.draw(count, rng) - self.mean) * spread


def student_log_density(errors: DoubleArray, scale: DoubleArray, freedom: float) -> DoubleArray:
    """Return the log density (...) of errors (..., d) under Student distributions about 0 with scales (..., d)."""
    squares = ((errors / scale) ** 2).sum(axis=-1)
    found: DoubleArray = _student(squares, errors.shape[-1], freedom) - np.log(scale).sum(axis=-1)
    return found


def _student(squares: DoubleArray, dimensions: int, freedom: float) -> DoubleArray:
    """Return the log density at squared distances (...) in units of the scale."""
    constant = math.lgamma((freedom + dimensions) / 2.0) - math.lgamma(freedom / 2.0)
    constant -= dimensions / 2.0 * math.log(freedom * math.pi)
    return constant - (freedom + dimensions) / 2.0 * np.log1p(squares / freedom)
