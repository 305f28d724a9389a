"""Statistics of a set of pushes beside the published ones of Omnipush."""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from training.omnipush.files import Array
from training.omnipush.published import Normalisation

QUANTITIES: Final = (
    "pusher x_m",
    "pusher y_m",
    "pusher angle_rad",
    "object x_m",
    "object y_m",
    "object yaw_rad",
)
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
