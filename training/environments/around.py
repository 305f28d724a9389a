"""Pushes about an object as three numbers from -1 to 1, for learners: each of them touches the object.

They are the heading of the push, the place of its line across the object, and the travel after the first contact.
"""

import math
from typing import Final

import numpy as np

from service.pushing.outlines import Outline
from service.pushing.poses import DoubleArray, wrap_angle
from training.simulation.approach import travel_to_touch_m

GAP_M: Final = 0.005  # from start to first contact, along the push
LONGEST_TRAVEL_M: Final = 0.1  # after the first contact
_GRAZE_M: Final = 1e-6  # a line that passes nearer to the edge of the width may miss by rounding
_FAR: Final = 3.0  # in extents of the outline


def push_around(outline: Outline, pose: DoubleArray, pusher_radius_m: float, numbers: DoubleArray) -> DoubleArray:
    """Return the push (4,), x_m, y_m, angle_rad, length_m in the world, that three numbers name.

    Args:
        outline: the object.
        pose: (3,) of the object in the world.
        pusher_radius_m: radius of the tip.
        numbers: (3,) from -1 to 1. Others are clipped. The heading in the object frame over pi, the place of the line
            from the right edge of the object, as the tip sees it, to the left, and the travel from 0 to 0.1 m.
    """
    heading, across, travel = np.clip(numbers, -1.0, 1.0)
    angle = math.pi * float(heading)
    ahead = np.array([math.cos(angle), math.sin(angle)])
    left = np.array([-ahead[1], ahead[0]])
    places = (outline.corners - outline.centroid_m) @ left
    reach_m = pusher_radius_m - _GRAZE_M
    low, high = places.min() - reach_m, places.max() + reach_m
    offset_m = (low + high) / 2.0 + across * (high - low) / 2.0
    far = outline.centroid_m + offset_m * left - (_FAR * outline.extent_m + pusher_radius_m) * ahead
    touch_m = float(travel_to_touch_m(outline, far[None], ahead[None], pusher_radius_m)[0])
    x, y = far + (touch_m - GAP_M) * ahead
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    start = pose[0] + cos * x - sin * y, pose[1] + sin * x + cos * y
    return np.array([*start, wrap_angle(float(pose[2]) + angle), GAP_M + (travel + 1.0) / 2.0 * LONGEST_TRAVEL_M])
