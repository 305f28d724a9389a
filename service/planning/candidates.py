"""Candidate pushes of one object: places around its outline, angles from the inward normal, and travels in contact.

A push has an allowed length, the smallest that covers its travel in contact and the least gap before it. The rest of
the length is the gap from which the tip starts, so a few allowed lengths give any travel. Parameters are spread by a
low-discrepancy sequence (Roberts 2018, the generalised golden ratio), so that any number of candidates covers the
object evenly and the same number is the same candidates.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np

from service.planning.push_model import PushModel, PushOutcomes
from service.pushing.outlines import Outline
from service.pushing.poses import DoubleArray, wrap_angles
from service.turns import pause

LEAST_GAP_M: Final = 0.003  # between tip and object at the start, above the error of a robot's pose
LEAST_TRAVEL_M: Final = 0.002  # in contact
WIDEST_RAD: Final = 0.7  # from the inward normal. Friction cones are narrower, and a tip that slides turns the object
ROWS_AT_ONCE: Final = 256  # rows of a model between two pauses
_ROUNDING: Final = 1e-9
_GOLDEN: Final = 1.2207440846057596  # of three dimensions: the root of x^4 = x + 1


@dataclass(frozen=True, eq=False, slots=True)
class Candidates:
    """Candidate pushes and their predicted motions.

    Attributes:
        parameters: (n, 3) place along the outline as a share of it, angle from the inward normal, travel in m.
        pushes: (n, 4) x_m, y_m, angle_rad, length_m in the object frame.
        motions: (n, 3) predicted means.
        std: (n, 3) predicted deviations of the object frame.
        centre_std: (n, 3) likewise of the object's centre, and of its yaw.
    """

    parameters: DoubleArray
    pushes: DoubleArray
    motions: DoubleArray
    std: DoubleArray
    centre_std: DoubleArray


@dataclass(frozen=True, eq=False, slots=True)
class Pusher:
    """Pusher of one object: a model of its pushes, the outline, the radius of the tip, and the allowed lengths.

    Attributes:
        model: of the object.
        outline: of the object, in the object frame.
        radius_m: of the tip.
        lengths_m: (l,) allowed, ascending.
    """

    model: PushModel
    outline: Outline
    radius_m: float
    lengths_m: DoubleArray

    @property
    def longest_m(self) -> float:
        """Return the longest travel in contact."""
        return float(self.lengths_m[-1]) - LEAST_GAP_M

    def spread(self, count: int) -> DoubleArray:
        """Return parameters (count, 3) that cover the object evenly."""
        steps = np.arange(1, count + 1)[:, None] / _GOLDEN ** np.arange(1, 4)
        along, angle, travel = (steps % 1.0).T
        shortest = min(LEAST_TRAVEL_M, self.longest_m)
        travel = shortest * (self.longest_m / shortest) ** np.sqrt(travel)
        return np.stack([along, WIDEST_RAD * (2.0 * angle - 1.0), travel], axis=1)

    def candidates(self, parameters: DoubleArray, is_over: Callable[[], bool]) -> Candidates:
        """Return the pushes of parameters (n, 3) that start clear of the object and move it, with their outcomes.

        Pushes that the model does not vouch for are left out, unless there are no others. Parts after the first are
        not predicted once ``is_over`` returns true.
        """
        pushes = self._pushes(parameters)
        clear = self.outline.distance_m(pushes[:, :2]) >= self.radius_m + LEAST_GAP_M * (1.0 - _ROUNDING)
        parameters, pushes = parameters[clear], pushes[clear]
        parts: list[PushOutcomes] = []
        for first in range(0, len(pushes), ROWS_AT_ONCE):
            if parts and is_over():
                break
            parts.append(self.model(pushes[first : first + ROWS_AT_ONCE]))
            pause()
        if not parts:
            return Candidates(parameters, pushes, *np.zeros((3, 0, 3)))
        mean = np.concatenate([part.mean for part in parts])
        std, centre_std = (
            np.concatenate(found) for found in ([part.frame_std() for part in parts], [part.std for part in parts])
        )
        kept = ~np.concatenate([part.misses for part in parts])
        familiar = kept & ~np.concatenate([part.unfamiliar for part in parts])
        rows = np.flatnonzero(familiar if familiar.any() else kept)
        return Candidates(parameters[rows], pushes[rows], mean[rows], std[rows], centre_std[rows])

    def _pushes(self, parameters: DoubleArray) -> DoubleArray:
        """Return the pushes (n, 4) of parameters (n, 3)."""
        point, normal = self.outline.along(parameters[:, 0])
        angle = np.arctan2(normal[:, 1], normal[:, 0]) + parameters[:, 1]
        travel = parameters[:, 2]
        fits = np.searchsorted(self.lengths_m, travel + LEAST_GAP_M * (1.0 - _ROUNDING))
        length = self.lengths_m[np.minimum(fits, len(self.lengths_m) - 1)]
        ahead = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        start = point - self.radius_m * normal - (length - travel)[:, None] * ahead
        return np.column_stack([start, wrap_angles(angle), length])
