"""Contact: which pushes never touch their object, and which start inside it.

Cheap bounds settle most pushes: discs inside the object that the tip is sure to meet, and the object's reach, beyond
which no start is inside. The exact form decides the others. A model of any shape tells by itself that a push misses:
its mean is exactly zero. It is not asked for starts inside.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from service.model.tensors import ContextKind, FloatArray
from service.pushing.outlines import Outline
from service.pushing.poses import DoubleArray
from service.pushing.shape_context import BODY, PUSHER_RADIUS_M, ShapeTensors
from service.validity.known_objects import Contexts, Form, KnownObject, Polygon, known_object, known_objects

OVERLAP_M: Final = 0.001  # a tip that overlaps by less touches: starts at touch are known to a fraction of it
_RADIUS_PLACE: Final = BODY.index("pusher_radius")
Rows = npt.NDArray[np.bool_]


@dataclass(frozen=True, eq=False, slots=True)
class Contact:
    """Contact of n pushes with their objects.

    Attributes:
        misses: (n,) true for the pushes that never touch.
        inside: (n,) true for the pushes whose tip starts inside, or overlaps by more than ``OVERLAP_M``.
        rows: (n, 4) the pushes, x_m, y_m, angle_rad, length_m.
        form_of: function of a row: the form of its object, and the radius of the tip in m.
    """

    misses: Rows
    inside: Rows
    rows: DoubleArray
    form_of: Callable[[int], tuple[Form, float]]

    def describe_miss(self, row: int) -> str:
        """Say how far the tip stays away from the object."""
        form, radius_m = self.form_of(row)
        gap_mm = max(form.gap_m(self.rows[row]) - radius_m, 0.0) * 1e3
        near = f"comes no nearer than {_in_mm(gap_mm)} mm" if np.isfinite(gap_mm) else "comes nowhere near"
        return f"the tip {near} to the object on its way of {_in_mm(self.rows[row, 3] * 1e3)} mm, so the object stays"

    def describe_inside(self, row: int) -> str:
        """Say how deep the tip starts."""
        form, radius_m = self.form_of(row)
        depth_mm = (radius_m - float(form.distance_m(self.rows[row : row + 1, :2])[0])) * 1e3
        tip = f"the tip of radius {radius_m * 1e3:.3g} mm"
        return f"{tip} overlaps the object by {_in_mm(depth_mm)} mm before the push: start it outside"


def is_plain_contact(known: KnownObject, x: float, y: float, angle: float, length: float, radius_m: float) -> bool:
    """Return True if a push surely starts outside and touches, as the bounds alone show. A few microseconds."""
    beside, above = (x, y) if abs(x) >= abs(y) else (y, x)
    side = (0 if x > 0.0 else 2) if abs(x) >= abs(y) else (1 if y > 0.0 else 3)
    is_near = abs(beside) <= known.reach_m[side] + radius_m and abs(above) <= known.half_width_m + radius_m
    if is_near and math.hypot(x, y) <= known.furthest_m + radius_m:
        return False
    cos, sin = math.cos(angle), math.sin(angle)
    for centre_x, centre_y, disc_m in known.discs:
        ahead_x, ahead_y = centre_x - x, centre_y - y
        along = ahead_x * cos + ahead_y * sin
        if along > 0.0:
            along = min(along, length)
            aside_x, aside_y, apart = ahead_x - along * cos, ahead_y - along * sin, disc_m + radius_m
            if aside_x * aside_x + aside_y * aside_y <= apart * apart:
                return True
    return False


def contacts(contexts: Contexts, rows: DoubleArray, mean: FloatArray) -> Contact:
    """Return the contact of pushes (n, 4), x_m, y_m, angle_rad, length_m, with predicted means (n, 3)."""
    if contexts.kind is ContextKind.SHAPE and contexts.index is not None:
        index, shapes = contexts.index, ShapeTensors(*contexts.tensors)
        return Contact(
            (mean == 0.0).all(axis=1),
            np.zeros(len(rows), dtype=np.bool_),
            rows,
            lambda row: (_polygon(shapes.outline[index[row]]), float(shapes.body[index[row], _RADIUS_PLACE])),
        )
    misses, inside = np.zeros((2, len(rows)), dtype=np.bool_)
    for known, group in known_objects(contexts):
        misses[group], inside[group] = contact(known, rows[group], PUSHER_RADIUS_M)

    def form_of(row: int) -> tuple[Form, float]:
        """Return the form of the object of a row."""
        place = 0 if contexts.index is None else contexts.index[row]
        return known_object(contexts.kind, contexts.tensors[0][place].tobytes()).form, PUSHER_RADIUS_M

    return Contact(misses, inside, rows, form_of)


def contact(known: KnownObject, pushers: DoubleArray, radius_m: float) -> tuple[Rows, Rows]:
    """Return which pushes (n, 4) of one object miss it, and which start inside."""
    misses, inside = ~_surely_touch(known, pushers, radius_m), _may_start_inside(known, pushers, radius_m)
    doubtful = np.flatnonzero(misses)
    if len(doubtful):
        misses[doubtful] = known.form.misses(pushers[doubtful], radius_m)
    doubtful = np.flatnonzero(inside)
    if len(doubtful):
        inside[doubtful] = known.form.distance_m(pushers[doubtful, :2]) < radius_m - OVERLAP_M - known.margin_m
    return misses & ~inside, inside


def _in_mm(value: float) -> str:
    return f"{value:.0f}" if value >= 10.0 else f"{value:.2g}"


def _polygon(corners: FloatArray) -> Polygon:
    """Return the form of an outline (64, 2) of a graph, whose last corner is repeated."""
    count = len(corners)
    while count > 1 and np.array_equal(corners[count - 1], corners[count - 2]):
        count -= 1
    return Polygon(Outline(corners[:count].astype(np.float64)))


def _surely_touch(known: KnownObject, pushers: DoubleArray, radius_m: float) -> Rows:
    cos, sin, length = np.cos(pushers[:, 2]), np.sin(pushers[:, 2]), pushers[:, 3]
    found = np.zeros(len(pushers), dtype=np.bool_)
    for centre_x, centre_y, disc_m in known.discs:
        x, y = centre_x - pushers[:, 0], centre_y - pushers[:, 1]
        along = np.clip(x * cos + y * sin, 0.0, length)
        found |= (x - along * cos) ** 2 + (y - along * sin) ** 2 <= (disc_m + radius_m) ** 2
    return found


def _may_start_inside(known: KnownObject, pushers: DoubleArray, radius_m: float) -> Rows:
    x, y = pushers[:, 0], pushers[:, 1]
    first, second, third, fourth = known.reach_m
    beside = np.where(x > 0.0, first, third) + radius_m
    above = np.where(y > 0.0, second, fourth) + radius_m
    near_x, near_y = np.abs(x) <= beside, np.abs(y) <= above
    thin = np.minimum(np.abs(x), np.abs(y)) <= known.half_width_m + radius_m
    return np.asarray(near_x & near_y & thin & (np.hypot(x, y) <= known.furthest_m + radius_m))
