"""First contact: where a round tip that moves along a straight line meets an outline, in closed form.

The tip's centre touches when it reaches the outline grown by the tip's radius. That curve consists of the edges, moved
outward by the radius, and of circles about the corners. The first crossing with either is the contact:

    edge with outward normal n through a:   travel = ((p - a) . n - r) / (-d . n)   for d . n < 0, beside the edge
    corner v:                               travel = -b - sqrt(b^2 - |p - v|^2 + r^2)   with b = d . (p - v)

for a tip of radius r that starts at p and moves along the unit vector d. Every push is compared with every edge and
corner, in chunks of bounded memory. numpy only.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from service.pushing.outlines import Outline
from service.pushing.poses import DoubleArray

_CHUNK_PAIRS: Final = 1 << 16  # pairs of a push and an edge at a time: a few MB
_TOUCH_M: Final = 1e-9


@dataclass(frozen=True, eq=False)
class FirstContact:
    """First contacts of n pushes with one outline, in the outline's frame."""

    travel_m: DoubleArray
    """(n,) from the start to the contact. 0 if the tip touches or overlaps at the start, inf if the push misses."""
    point_m: DoubleArray
    """(n, 2) on the outline, or NaN for a miss."""
    normal: DoubleArray
    """(n, 2) unit vector at the contact that points into the object, or NaN for a miss.

    It leads from the tip's centre to the contact, so at a corner it depends on the tip.
    """


def first_contact(
    outline: Outline, pushers: DoubleArray, pusher_radius_m: npt.ArrayLike, direction: DoubleArray | None = None
) -> FirstContact:
    """Return the first contacts of pushers (n, 4): x_m, y_m, angle_rad, length_m.

    Args:
        outline: the object.
        pushers: where the tip's centre starts, its direction, and its travel. A length of inf never ends.
        pusher_radius_m: radius of the tip, positive, one for all or (n,).
        direction: unit vectors (n, 2) along the angles, if the caller has them to the same bits on every processor.
    """
    pushers = np.asarray(pushers, dtype=np.float64)
    radius_m = np.broadcast_to(np.asarray(pusher_radius_m, dtype=np.float64), len(pushers))
    start = pushers[:, :2]
    if direction is None:
        direction = np.stack([np.cos(pushers[:, 2]), np.sin(pushers[:, 2])], axis=1)
    distance = outline.distance_m(start)
    travel = np.empty(len(pushers))
    rows = max(1, _CHUNK_PAIRS // len(outline.corners))
    for first in range(0, len(pushers), rows):
        part = slice(first, first + rows)
        travel[part] = _travel(outline, start[part], direction[part], radius_m[part])
    travel = np.where(distance <= radius_m + _TOUCH_M, 0.0, travel)  # rounding must not turn a touch into a miss
    travel[travel > pushers[:, 3]] = np.inf
    touches = np.isfinite(travel)
    point, normal = np.full((len(pushers), 2), np.nan), np.full((len(pushers), 2), np.nan)
    tip = start[touches] + travel[touches, None] * direction[touches]
    nearest = outline.nearest(tip)
    point[touches], normal[touches] = nearest.point_m, nearest.normal
    return FirstContact(travel, point, normal)


def _travel(outline: Outline, start: DoubleArray, direction: DoubleArray, radius_m: DoubleArray) -> DoubleArray:
    """Return the travel (n,) of tips that start outside to their first contact, or inf."""
    edges = outline.edges
    length = np.sqrt((edges**2).sum(axis=1))
    unit = edges / length[:, None]
    offset = start[:, None, :] - outline.corners  # (n, edges, 2)
    radius = radius_m[:, None]
    height = offset[..., 0] * unit[:, 1] - offset[..., 1] * unit[:, 0]  # outside of each edge
    approach = direction[:, 1, None] * unit[:, 0] - direction[:, 0, None] * unit[:, 1]
    place = offset[..., 0] * unit[:, 0] + offset[..., 1] * unit[:, 1]  # along each edge
    drift = direction[:, 0, None] * unit[:, 0] + direction[:, 1, None] * unit[:, 1]
    to_edge = (height - radius) / np.where(approach > 0.0, approach, np.nan)
    met = place + to_edge * drift
    to_edge = np.where((to_edge >= 0.0) & (met >= 0.0) & (met <= length), to_edge, np.inf)  # NaN compares as false
    towards = direction[:, 0, None] * offset[..., 0] + direction[:, 1, None] * offset[..., 1]
    room = towards**2 - (offset**2).sum(axis=2) + radius**2
    to_corner = -towards - np.sqrt(np.where(room >= 0.0, room, np.nan))
    to_corner = np.where(to_corner >= 0.0, to_corner, np.inf)
    travel: DoubleArray = np.minimum(to_edge, to_corner).min(axis=1)
    return travel
