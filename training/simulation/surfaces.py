"""Surfaces under the objects: friction that varies over the plate, from push to push and, on wood, with the grain.

Figures: Yu, Bauza, Fazeli, Rodriguez, "More than a million ways to be pushed", IROS 2016, section V. The coefficient of
a new ABS plate falls from 0.15 to 0.13 within 100 scans, of plywood from 0.28 to 0.24. Over the plate it spreads like a
Gaussian of 0.017 on ABS and 0.024 on plywood. ABS is close to isotropic, plywood slightly less so. The paper prints
maps, but neither a correlation length of friction nor a ratio for the grain. Both are assumptions, listed below.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

TABLE_HALF_WIDTH_M: Final = 0.10  # objects are put down within this square around the middle of the plate
LEAST_FRICTION: Final = 0.02
_WAVES: Final = 256


@dataclass(frozen=True)
class Surface:
    """Surface: a plate of one material."""

    name: str
    level: tuple[float, float]  # friction coefficients of a worn and a new plate, limits of the draw for every push
    spread: float  # standard deviation of the coefficient over the plate
    correlation_m: float  # length over which it changes
    grain: float  # friction across the grain over friction along it, which is the world's x axis


# A correlation length of 3 cm and the grain are assumptions, set so that a repeated push scatters about as in table IV
# of the paper (``benchmarks/repeatability.py``). It reports "slight anisotropy" on both, and 3/2 on polyurethane.
ABS: Final = Surface("abs", (0.13, 0.15), 0.017, 0.030, 1.05)
PLYWOOD: Final = Surface("plywood", (0.24, 0.28), 0.024, 0.030, 1.1)
# Constant friction everywhere, for tests of the mechanics.
EVEN: Final = Surface("even", (0.14, 0.14), 0.0, 0.030, 1.0)
SURFACES: Final = {surface.name: surface for surface in (ABS, PLYWOOD)}


class FrictionField:
    """Friction field: the deviation of a plate's friction coefficient from its level, at every place.

    A stationary Gaussian field with a squared-exponential covariance, as a sum of random waves (Rahimi and Recht,
    "Random features for large-scale kernel machines", 2007).
    """

    def __init__(self, surface: Surface, rng: np.random.Generator) -> None:
        self._spread = surface.spread
        self._wave_vectors = rng.normal(0.0, 1.0 / surface.correlation_m, (_WAVES, 2))  # rad/m
        self._phases = rng.uniform(0.0, 2.0 * np.pi, _WAVES)

    def at(self, places_m: Array) -> Array:
        """Compute the deviation from the level, (...), at places (..., 2) on the plate in metres."""
        waves = np.cos(places_m @ self._wave_vectors.T + self._phases)
        return np.asarray(self._spread * np.sqrt(2.0 / _WAVES) * waves.sum(axis=-1))


@dataclass(frozen=True)
class Conditions:
    """Conditions of n pushes that vary from push to push and are not recorded."""

    surface: Surface
    field: FrictionField
    world_poses: Array  # (n, 3): the object's pose on the plate before the push, m, m, rad
    table_level: Array  # (n,): friction of feet on the plate, before the field
    contact: Array  # (n,): friction of the pusher on the object

    def table_friction(self, feet_m: Array) -> Array:
        """Compute the friction across and along the grain, (n, feet, 2), of feet at (n, feet, 2) on the plate."""
        level = np.maximum(self.table_level[:, None] + self.field.at(feet_m), LEAST_FRICTION)
        across = np.sqrt(self.surface.grain)  # the mean of both directions stays the level
        return np.stack([level * across, level / across], axis=-1)


# Yu et al., section IV: "approximately 0.25", steel on the object. The spread is that of the table, in proportion.
CONTACT_FRICTION: Final = 0.25
CONTACT_FRICTION_SPREAD: Final = 0.03


def draw_conditions(surface: Surface, field: FrictionField, count: int, rng: np.random.Generator) -> Conditions:
    """Draw the conditions of ``count`` pushes: anywhere on the plate, at any yaw."""
    place = rng.uniform(-TABLE_HALF_WIDTH_M, TABLE_HALF_WIDTH_M, (count, 2))
    yaw = rng.uniform(-np.pi, np.pi, count)
    contact = rng.normal(CONTACT_FRICTION, CONTACT_FRICTION_SPREAD, count)
    return Conditions(
        surface,
        field,
        np.column_stack([place, yaw]),
        rng.uniform(*surface.level, count),
        np.maximum(contact, LEAST_FRICTION),
    )


def even_conditions(count: int) -> Conditions:
    """Return conditions without variation: the object at the world's origin, the same friction everywhere."""
    return Conditions(
        EVEN,
        FrictionField(EVEN, np.random.default_rng(0)),
        np.zeros((count, 3)),
        np.full(count, EVEN.level[0]),
        np.full(count, CONTACT_FRICTION),
    )
