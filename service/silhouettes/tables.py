"""Tables: the light on an empty table, fitted as a smooth surface to the pixels that are not the object."""

from typing import Final

import numpy as np
import numpy.typing as npt

from service.silhouettes.mixtures import squares
from service.silhouettes.planes import Mask, Plane

NOISE: Final = 0.012  # least standard deviation of a table's pixels
_FLOOR: Final = np.eye(3, dtype=np.float32) * np.float32(NOISE**2)
DARK: Final = np.float32(0.08)  # added to levels of 0 to 1, so that ratios of dark ones stay calm
_ROUNDS: Final = 6
_INLIER: Final = 9.0  # squared Mahalanobis distance up to which a pixel may belong to the table


def light_ratios(levels: npt.NDArray[np.uint8], weights: Plane, degree: int) -> tuple[Plane, Mask]:
    """Return each pixel over the table that would be there, [h, w, 3], and the pixels that look like it, [h, w].

    The table is a polynomial of each channel. Pixels that differ are left out, and it is fitted again. In ratios, the
    table is 1 in all channels, and a shadow is darker by the same factor in each.

    Args:
        levels: [h, w, 3] colours of 8 bits.
        weights: [h, w] prior weight of each pixel as a part of the table.
        degree: of the polynomial.
    """
    height, width = levels.shape[:2]
    colours = levels.reshape(-1, 3).astype(np.float32) / np.float32(255.0) + DARK
    terms, degrees = _terms(height, width, degree)
    prior = weights.ravel()
    kept = prior
    for number in range(_ROUNDS):
        used = terms[:, degrees <= 1 + number]  # from flat to curved, so that no large object bends the table
        weighted = used * kept[:, None]
        normal = (weighted.T @ used).astype(np.float64) + 1e-6 * kept.sum() * np.eye(used.shape[1])
        factors = np.linalg.solve(normal, weighted.T @ colours).astype(np.float32)
        table = np.maximum(used @ factors, DARK / np.float32(2.0))
        ratios: Plane = colours / table
        offsets: Plane = ratios - np.float32(1.0)
        covariance = (offsets * kept[:, None]).T @ offsets / kept.sum() + _FLOOR
        alike = squares(offsets, covariance) < _INLIER
        kept = prior * alike
        if kept.sum() < 0.05 * prior.sum():
            break
    return ratios.reshape(height, width, 3), alike.reshape(height, width)


def _terms(height: int, width: int, degree: int) -> tuple[Plane, npt.NDArray[np.int64]]:
    """Return the terms of a polynomial in both coordinates, (pixels, terms), and the degree of each."""
    x = np.linspace(-1.0, 1.0, width, dtype=np.float32)[None, :]
    y = np.linspace(-1.0, 1.0, height, dtype=np.float32)[:, None]
    powers = [(i, j) for i in range(degree + 1) for j in range(degree + 1 - i)]
    terms = np.stack([(x**i * y**j).ravel() for i, j in powers], axis=1)
    return terms, np.array([i + j for i, j in powers])
