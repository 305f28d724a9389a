"""Model of the pushes of one object, as planning sees it: from pushes in the object frame to Gaussians."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from service.pushing.poses import DoubleArray

Rows = npt.NDArray[np.bool_]


@dataclass(frozen=True, eq=False, slots=True)
class PushOutcomes:
    """Predicted outcomes of n pushes of one object, in the object frame before each push.

    Attributes:
        mean: (n, 3) x_m, y_m, yaw_rad of the object after the push.
        std: (n, 3) standard deviations, m, m, rad. The three are independent.
        misses: (n,) true for the pushes that never touch the object.
        inside: (n,) true for the pushes whose tip starts inside of the object, where its form is known.
        unfamiliar: (n,) true for the pushes that the model does not vouch for.
    """

    mean: DoubleArray
    std: DoubleArray
    misses: Rows
    inside: Rows
    unfamiliar: Rows


class PushModel(Protocol):
    """Model of the pushes of one object."""

    def __call__(self, pushes: DoubleArray) -> PushOutcomes:
        """Predict pushes (n, 4), x_m, y_m, angle_rad, length_m, of the pusher's tip in the object frame."""
        ...
