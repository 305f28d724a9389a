"""How like the published pushes a dataset is: statistics beside Omnipush's, pushes that missed."""

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from training.data import Pushes, published_normalisation

# A push that moved the object by less than both has missed it: beyond what the tracker's noise does to a still one.
CONTACT_DISPLACEMENT_M: Final = 0.001
CONTACT_TURN_RAD: Final = 0.015


def missed_share(outcomes: npt.NDArray[np.floating[Any]]) -> float:
    """Share of pushes that did not move the object; outcomes (..., 3)."""
    still = np.hypot(outcomes[..., 0], outcomes[..., 1]) < CONTACT_DISPLACEMENT_M
    return float(np.mean(still & (np.abs(outcomes[..., 2]) < CONTACT_TURN_RAD)))


def likeness(pushes: Pushes) -> Sequence[tuple[str, float, float, float, float]]:
    """Beside the published statistics: (quantity, mean here, published mean, std here, published std), SI units."""
    published = published_normalisation()
    present = pushes.valid > 0
    rows: list[tuple[str, float, float, float, float]] = []
    for label, values, mean, std in (
        ("pusher", pushes.pushers[present], published.input_mean, published.input_std),
        ("object", pushes.outcomes[present], published.output_mean, published.output_std),
    ):
        for column, name in enumerate(("x_m", "y_m", "angle_rad")):
            here = values[:, column].astype(np.float64)
            rows.append((f"{label} {name}", float(here.mean()), mean[column], float(here.std()), std[column]))
    return rows
