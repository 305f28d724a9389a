"""Statistics of a set of pushes: means and deviations beside those of Omnipush, and quantiles of the motion."""

import math
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from training.omnipush.files import Array
from training.omnipush.published import Normalisation, recorded_outcomes

QUANTITIES: Final = (
    "pusher x_m",
    "pusher y_m",
    "pusher angle_rad",
    "object x_m",
    "object y_m",
    "object yaw_rad",
)
QUANTILES: Final = (0.05, 0.25, 0.5, 0.75, 0.95)
# A push that moved the object by less than both missed it. Both limits are above the tracker's noise.
CONTACT_DISPLACEMENT_M: Final = 0.001
CONTACT_TURN_RAD: Final = 0.015


@dataclass(frozen=True)
class QuantityStatistics:
    """Statistics of one quantity: mean and standard deviation here and as published, in SI units."""

    quantity: str
    mean: float
    published_mean: float
    std: float
    published_std: float

    @property
    def ratio(self) -> float:
        """Ratio of the standard deviation here to the published one."""
        return self.std / self.published_std


def compare_statistics(pushers: Array, outcomes: Array, published: Normalisation) -> tuple[QuantityStatistics, ...]:
    """Compute the statistics of the six quantities of pushes, [n, 3] each, beside the published ones."""
    values = np.column_stack([pushers, outcomes])
    numbers = np.column_stack(
        [
            values.mean(axis=0),
            np.concatenate([published.input_mean, published.output_mean]),
            values.std(axis=0),
            np.concatenate([published.input_std, published.output_std]),
        ]
    )
    return tuple(QuantityStatistics(name, *row) for name, row in zip(QUANTITIES, numbers.tolist(), strict=True))


def missed(outcomes: npt.NDArray[np.floating[Any]]) -> npt.NDArray[np.bool_]:
    """Return a mask, (...), of the pushes that did not move the object, from outcomes (..., 3)."""
    still = np.hypot(outcomes[..., 0], outcomes[..., 1]) < CONTACT_DISPLACEMENT_M
    return np.asarray(still & (np.abs(outcomes[..., 2]) < CONTACT_TURN_RAD))


@dataclass(frozen=True)
class MotionQuantiles:
    """Quantiles of the motion of objects: distance and turn of the pushes that moved one, and the share that did not.

    Means and deviations of two datasets may agree while one has no glancing push. Only quantiles show that.
    """

    still_share: float  # of all pushes, below both limits of contact
    distance_mm: tuple[float, ...]  # at QUANTILES, of the pushes that moved the object by over 1 mm; NaN without any
    turn_deg: tuple[float, ...]  # of the same pushes, without the sign


def motion_quantiles(outcomes: npt.NDArray[np.floating[Any]]) -> MotionQuantiles:
    """Compute the quantiles of outcomes, (n, 3), x_m, y_m, yaw_rad."""
    distance = np.hypot(outcomes[:, 0], outcomes[:, 1])
    moved = distance > CONTACT_DISPLACEMENT_M
    rows = [1e3 * distance[moved], np.abs(np.degrees(outcomes[moved, 2]))]
    levels = [tuple(np.quantile(row, QUANTILES).tolist()) if moved.any() else (math.nan,) * 5 for row in rows]
    return MotionQuantiles(float(missed(outcomes).mean()), *levels)


def recorded_motion() -> MotionQuantiles:
    """Return the quantiles of Omnipush's recordings: objects without weights on ABS, pushes that missed included."""
    recorded = recorded_outcomes()
    return MotionQuantiles(recorded.did_not_move_share, recorded.distance_mm, recorded.turn_deg)
