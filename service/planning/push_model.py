"""Model of the pushes of one object, as planning sees it: from pushes in the object frame to Gaussians."""

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
import numpy.typing as npt

from service.pushing.poses import DoubleArray

Rows = npt.NDArray[np.bool_]


@dataclass(frozen=True, eq=False, slots=True)
class PushOutcomes:
    """Predicted outcomes of n pushes of one object, in the object frame before each push.

    Attributes:
        mean: (n, 3) x_m, y_m, yaw_rad of the object frame after the push.
        std: (n, 3) standard deviations of x and y of the object's centre, and of its yaw, m, m, rad. They are
            independent. Those of a far origin of the frame are not: a turn moves it far.
        misses: (n,) true for the pushes that never touch the object.
        inside: (n,) true for the pushes whose tip starts inside of the object, where its form is known.
        unfamiliar: (n,) true for the pushes that the model does not vouch for.
        centre_m: (2,) the object's centre in the object frame.
    """

    mean: DoubleArray
    std: DoubleArray
    misses: Rows
    inside: Rows
    unfamiliar: Rows
    centre_m: DoubleArray = field(default_factory=lambda: np.zeros(2))

    def drawn(self, noise: DoubleArray) -> DoubleArray:
        """Return motions (..., n, 3) of the object frame, of independent standard normal numbers (..., n, 3)."""
        yaw = self.mean[:, 2] + self.std[:, 2] * noise[..., 2]
        centre = self.mean[:, :2] + _turned(self.centre_m, self.mean[:, 2]) + self.std[:, :2] * noise[..., :2]
        return np.concatenate([centre - _turned(self.centre_m, yaw), yaw[..., None]], axis=-1)

    def frame_std(self) -> DoubleArray:
        """Return the standard deviations (n, 3) of the pose of the object frame."""
        lever = _turned(self.centre_m, self.mean[:, 2])[:, ::-1]
        place = np.sqrt(self.std[:, :2] ** 2 + (lever * self.std[:, 2:]) ** 2)
        return np.concatenate([place, self.std[:, 2:]], axis=1)


class PushModel(Protocol):
    """Model of the pushes of one object."""

    def __call__(self, pushes: DoubleArray) -> PushOutcomes:
        """Predict pushes (n, 4), x_m, y_m, angle_rad, length_m, of the pusher's tip in the object frame."""
        ...


def _turned(place_m: DoubleArray, yaw_rad: DoubleArray) -> DoubleArray:
    """Return a place (2,) turned by yaws (...), (..., 2)."""
    cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
    x, y = place_m
    return np.stack([cos * x - sin * y, sin * x + cos * y], axis=-1)
