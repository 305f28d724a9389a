"""A box and quasi-static mechanics as the model of its pushes, for tests of planning."""

import numpy as np

from service.planning.push_model import PushOutcomes
from service.pushing import mechanics
from service.pushing.outlines import Outline
from service.pushing.poses import DoubleArray

BOX = Outline.of([[0.06, 0.04], [-0.06, 0.04], [-0.06, -0.04], [0.06, -0.04]])
RADIUS_M = 0.005
STD = (0.001, 0.001, 0.02)


class Mechanics:
    """Model of a box that presses evenly. Every push deviates by ``STD``.

    Attributes:
        rows: number of pushes of each call.
        unfamiliar_over_m: length above which it does not vouch for a push.
    """

    def __init__(self, outline: Outline = BOX, unfamiliar_over_m: float = 1.0) -> None:
        self.outline, self.unfamiliar_over_m = outline, unfamiliar_over_m
        self.rows: list[int] = []

    def __call__(self, pushes: DoubleArray) -> PushOutcomes:
        """Predict pushes (n, 4)."""
        self.rows.append(len(pushes))
        mean = mechanics.push(self.outline, pushes, RADIUS_M, steps=8)
        misses = (mean == 0.0).all(axis=1)
        never = np.zeros(len(pushes), dtype=np.bool_)
        return PushOutcomes(mean, np.tile(STD, (len(mean), 1)), misses, never, pushes[:, 3] > self.unfamiliar_over_m)


def square(x: float, y: float, side: float) -> Outline:
    """Return a square about a place."""
    half = side / 2.0
    return Outline.of([[x + half, y + half], [x - half, y + half], [x - half, y - half], [x + half, y - half]])
