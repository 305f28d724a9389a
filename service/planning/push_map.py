"""Push maps: pushes from all around the outline of an object, and how much each of them does.

Tips start just outside of the outline, at even distances along it, and head inwards at some angles from the normal.
Places where the tip does not fit, as in a narrow notch, are left out.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from service.planning.push_model import PushModel, PushOutcomes
from service.pushing.outlines import Outline
from service.pushing.poses import DoubleArray, wrap_angles

GAP_M: Final = 0.001  # between tip and outline at the start
USUAL_PLACES: Final = 48  # around an outline
_FITS_M: Final = 1e-6


@dataclass(frozen=True, eq=False, slots=True)
class OutlinePushes:
    """Pushes from around an outline, in the object frame.

    Attributes:
        pushes: (n, 4) x_m, y_m, angle_rad, length_m of the tip.
        points_m: (n, 2) the place of the outline that each push starts at.
    """

    pushes: DoubleArray
    points_m: DoubleArray


@dataclass(frozen=True, eq=False, slots=True)
class PushMap:
    """Push map of one object, in its frame.

    Attributes:
        around: the pushes.
        outcomes: their predicted outcomes.
        effectiveness: (n,) how far the points of the object move, as root mean square, over the length of the push.
        uncertainty_m: (n,) standard deviation of where the points of the object end, as root mean square.
    """

    around: OutlinePushes
    outcomes: PushOutcomes
    effectiveness: DoubleArray
    uncertainty_m: DoubleArray


def pushes_around(
    outline: Outline, places: int, angles_rad: npt.ArrayLike, length_m: float, pusher_radius_m: float
) -> OutlinePushes:
    """Return pushes from around an outline, those of one place after the other.

    Args:
        outline: the object.
        places: number of places along the outline, at even distances.
        angles_rad: (a,) directions of the pushes from each place, from the inward normal, counter-clockwise.
        length_m: length of every push.
        pusher_radius_m: radius of the tip.
    """
    points, inward = outline.along((np.arange(places) + 0.5) / places)
    starts = points - inward * (pusher_radius_m + GAP_M)
    fits = outline.distance_m(starts) >= pusher_radius_m - _FITS_M
    points, starts, inward = points[fits], starts[fits], inward[fits]
    angles = np.atleast_1d(np.asarray(angles_rad, dtype=np.float64))
    headings = wrap_angles(np.arctan2(inward[:, 1], inward[:, 0])[:, None] + angles).ravel()
    starts, points = np.repeat(starts, len(angles), axis=0), np.repeat(points, len(angles), axis=0)
    return OutlinePushes(np.column_stack([starts, headings, np.full(len(headings), length_m)]), points)


def push_map(model: PushModel, outline: Outline, around: OutlinePushes) -> PushMap:
    """Predict pushes from around an outline, and say how much each of them does."""
    outcomes = model(around.pushes)
    mean, std, size_m = outcomes.mean, outcomes.std, outline.size_m
    cos, sin = np.cos(mean[:, 2]), np.sin(mean[:, 2])
    x, y = outline.centroid_m
    shift_x, shift_y = mean[:, 0] + cos * x - sin * y - x, mean[:, 1] + sin * x + cos * y - y  # of the centroid
    moved_m = np.sqrt(shift_x**2 + shift_y**2 + 2.0 * (1.0 - cos) * size_m**2)
    spread_m = np.sqrt(std[:, 0] ** 2 + std[:, 1] ** 2 + (std[:, 2] * size_m) ** 2)
    return PushMap(around, outcomes, moved_m / around.pushes[:, 3], spread_m)
