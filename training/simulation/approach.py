"""Starts and aims over the whole approach to an object of any outline.

A **touching** push comes from a random direction, with its line anywhere over the outline's width, the pusher's own
included, and starts between touch and one length of the push before its first contact. Both are uniform by default, so
every part of the push may be left at contact, and glancing pushes are as frequent as their width. The lines of a share
of them are drawn near the centroid instead (``Approach.central_share``), as people who collect pushes aim at the
object. A **missing** push starts where a touching one may, heads anywhere, and never reaches the object.

Only functions of ``exact`` and exact operations are used, so that every processor draws the same bytes.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from service.pushing.first_contact import first_contact
from service.pushing.outlines import Outline
from training.simulation.exact import Array, directions

LEAST_GAP_M: Final = 0.0005  # between tip and outline along the push, above the noise of a tracker
_GRAZE_M: Final = 1e-6  # a line that passes nearer to the edge of the width may miss by rounding
_FAR: Final = 3.0  # in extents of the outline
_TRIES: Final = 8  # headings drawn at once for a push that misses


@dataclass(frozen=True)
class Approach:
    """Distribution of starts and aims. The touching pushes that are not central pass anywhere over the outline."""

    miss_share: float = 0.1
    central_share: float = 0.0  # of the touching pushes
    central_half_width: float = 0.6  # of their lines' distances from the centroid, in sizes of the outline
    gap_shapes: tuple[float, float] = (1.0, 1.0)  # beta distribution of the gaps over the length: touch, a length away

    def __post_init__(self) -> None:
        """Refuse shares that are none.

        Raises:
            ValueError: a share is outside 0..1, or every push misses.
        """
        shares = 0.0 <= self.miss_share < 1.0 and 0.0 <= self.central_share <= 1.0
        if not (shares and self.central_half_width > 0.0 and min(self.gap_shapes) >= 1.0):
            raise ValueError(
                "shares are 0 to 1, the share that misses below 1, the half width positive, the shapes 1 or more: "
                f"received {self}"
            )


def draw_pushers(
    outline: Outline,
    lengths_m: Array,
    pusher_radius_m: float,
    rng: np.random.Generator,
    approach: Approach = Approach(),
) -> Array:
    """Draw pushes of an object that start clear of it.

    The share that misses is met by the nearest whole number of pushes, in random places of the order.

    Args:
        outline: the object.
        lengths_m: (n,) length of each push.
        pusher_radius_m: radius of the tip.
        rng: source of all random numbers.
        approach: distribution of starts and aims.

    Returns:
        (n, 4): x_m, y_m, angle_rad, length_m, in the frame of the outline.
    """
    angles = rng.uniform(-np.pi, np.pi, len(lengths_m))
    central = rng.uniform(0.0, 1.0, len(lengths_m)) < approach.central_share
    starts = _touching_starts(outline, lengths_m, pusher_radius_m, angles, central, approach, rng)
    missing = rng.permutation(len(lengths_m))[: round(approach.miss_share * len(lengths_m))]
    while len(missing):
        headings = rng.uniform(-np.pi, np.pi, (len(missing), _TRIES))
        travel = travel_to_touch_m(
            outline, np.repeat(starts[missing], _TRIES, axis=0), directions(headings.ravel()), pusher_radius_m
        )
        misses = travel.reshape(headings.shape) > lengths_m[missing, None]
        found, first = misses.any(axis=1), misses.argmax(axis=1)
        angles[missing[found]] = headings[found, first[found]]
        missing = missing[~found]
    return np.column_stack([starts, angles, lengths_m])


def _touching_starts(
    outline: Outline,
    lengths_m: Array,
    radius_m: float,
    angles: Array,
    central: np.ndarray,
    approach: Approach,
    rng: np.random.Generator,
) -> Array:
    """Return the starts (n, 2) of pushes in the given directions that touch the outline."""
    ahead = directions(angles)
    left = np.stack([-ahead[:, 1], ahead[:, 0]], axis=1)
    corners = outline.corners - outline.centroid_m
    across = corners[:, 0] * left[:, :1] + corners[:, 1] * left[:, 1:]  # (n, corners)
    reach_m = radius_m - _GRAZE_M
    low, high = across.min(axis=1) - reach_m, across.max(axis=1) + reach_m
    half_width_m = approach.central_half_width * outline.size_m
    low = np.where(central, np.maximum(low, -half_width_m), low)
    high = np.where(central, np.minimum(high, half_width_m), high)
    offset = low + rng.uniform(0.0, 1.0, len(angles)) * (high - low)
    far = outline.centroid_m + offset[:, None] * left - _FAR * outline.extent_m * ahead
    even = approach.gap_shapes == (1.0, 1.0)
    share = rng.uniform(0.0, 1.0, len(angles)) if even else rng.beta(*approach.gap_shapes, len(angles))
    gap = LEAST_GAP_M + share * (lengths_m - LEAST_GAP_M)
    travel = travel_to_touch_m(outline, far, ahead, radius_m)
    return np.asarray(far + (travel - gap)[:, None] * ahead)


def travel_to_touch_m(outline: Outline, starts: Array, ahead: Array, radius_m: float) -> Array:
    """Compute the travel (n,) m of tips at (n, 2) along unit vectors (n, 2) to their first contact, inf for a miss."""
    endless = np.full((len(starts), 2), np.inf)  # the angle is not used, as the direction is given
    return first_contact(outline, np.hstack([starts, endless]), radius_m, ahead).travel_m
