"""Mixtures of Gaussians in colour space, fitted by expectation and maximisation, deterministic."""

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

Colours = npt.NDArray[np.float32]
SAMPLES: Final = 3000  # colours that a mixture is fitted to
_ROUNDS: Final = 5


@dataclass(frozen=True, eq=False)
class Mixture:
    """Mixture of k Gaussians.

    Attributes:
        shares: (k,) weights that sum to 1.
        means: (k, 3).
        covariances: (k, 3, 3).
    """

    shares: Colours
    means: Colours
    covariances: Colours

    def log_density(self, colours: Colours) -> Colours:
        """Return the logarithm (n,) of the density at colours (n, 3), without the constant of the dimension."""
        parts = self._parts(colours)
        largest = parts.max(axis=1)
        return np.asarray(largest + np.log(np.exp(parts - largest[:, None]).sum(axis=1)))

    def _parts(self, colours: Colours) -> Colours:
        """Return the logarithm (n, k) of each Gaussian's part."""
        logs = np.log(self.shares) - 0.5 * np.log(np.linalg.det(self.covariances))
        return np.stack(
            [
                log - 0.5 * squares(colours - mean, covariance)
                for log, mean, covariance in zip(logs, self.means, self.covariances, strict=True)
            ],
            axis=1,
        )


def squares(offsets: Colours, covariance: Colours) -> Colours:
    """Return the squared Mahalanobis distances of offsets (..., 3)."""
    inverse = np.linalg.inv(covariance.astype(np.float64)).astype(np.float32)
    return np.asarray(((offsets @ inverse) * offsets).sum(axis=-1))


def sampled(colours: Colours, count: int = SAMPLES) -> Colours:
    """Return at most ``count`` of some colours (n, 3), evenly spaced."""
    return colours[:: max(1, -(-len(colours) // count))]


def fitted(colours: Colours, count: int, blur: float) -> Mixture:
    """Fit a mixture to colours (n, 3), its Gaussians widened by a standard deviation.

    It starts from the colour nearest to the mean, and from those that are farthest from all starts so far.
    """
    colours = sampled(colours)
    starts = [int(((colours - colours.mean(axis=0)) ** 2).sum(axis=1).argmin())]
    distance = ((colours - colours[starts[0]]) ** 2).sum(axis=1)
    for _ in range(min(count, len(colours)) - 1):
        typical = np.where(distance <= np.quantile(distance, 0.98), distance, 0.0)  # outliers are no start
        starts.append(int(typical.argmax()))
        distance = np.minimum(distance, ((colours - colours[starts[-1]]) ** 2).sum(axis=1))
    nearest = ((colours[:, None] - colours[starts]) ** 2).sum(axis=2).argmin(axis=1)
    belongs = np.eye(len(starts), dtype=np.float32)[nearest]
    for _ in range(_ROUNDS):
        mixture = _mixture(colours, belongs, blur)
        parts = mixture._parts(colours)
        belongs = np.exp(parts - parts.max(axis=1, keepdims=True))
        belongs /= belongs.sum(axis=1, keepdims=True)
    return _mixture(colours, belongs, blur)


def _mixture(colours: Colours, belongs: Colours, blur: float) -> Mixture:
    mass = belongs.sum(axis=0) + np.float32(1e-3)
    means = (belongs.T @ colours) / mass[:, None]
    wide = np.eye(3, dtype=np.float32) * np.float32(blur**2)
    covariances = [
        ((colours - mean) * belongs[:, part, None]).T @ (colours - mean) / mass[part] + wide
        for part, mean in enumerate(means)
    ]
    return Mixture(mass / mass.sum(), means, np.stack(covariances))
