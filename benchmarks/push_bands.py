"""Bands of pushes of any objects: by start, aim, length, size, tip and family.

A push that touches its object has a band of every kind. Pushes that miss are a band of their own, because every answer
to them is the same: the object stays.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np
import numpy.typing as npt

from service.pushing.first_contact import first_contact
from service.pushing.poses import DoubleArray
from training.tables.push_table import PushTable

Mask = npt.NDArray[np.bool_]
FAMILY: Final = "family"
SPREAD: Final = "touching or missing"
_MM: Final = 1e3
EDGES: Final[Mapping[str, tuple[float, ...]]] = {
    "start: gap from tip to outline (mm)": (0.0, 2.0, 10.0, 30.0, 60.0, 120.0),
    "aim: offset of the line from the centroid (sizes)": (0.0, 0.25, 0.5, 0.75, 1.0, np.inf),
    "aim: angle of the push to the normal (degrees)": (0.0, 15.0, 30.0, 45.0, 60.0, 90.0),
    "length (mm)": (5.0, 10.0, 20.0, 40.0, 80.0, 120.0),
    "size (mm)": (0.0, 10.0, 20.0, 40.0, 70.0, np.inf),
    "radius of the tip (mm)": (2.0, 3.5, 5.0, 8.0, 15.0),
}
_EDGE_SLACK: Final = 1e-6  # a value that rounding moved past the last edge belongs to the last band


@dataclass(frozen=True)
class Features:
    """Features of n pushes of a table, in the order of ``EDGES``, and the pushes that touch their object.

    Attributes:
        values: (n,) of each kind. NaN for a push that misses.
        touches: (n,).
        size_m: (n,) root mean square radius of the object's area.
    """

    values: Mapping[str, DoubleArray]
    touches: Mask
    size_m: DoubleArray


def features(table: PushTable) -> Features:
    """Compute the features of the pushes of a table."""
    gap, offset, angle, size = (np.full(table.count, np.nan) for _ in range(4))
    direction = np.stack([np.cos(table.pushers[:, 2]), np.sin(table.pushers[:, 2])], axis=1)
    touches = np.zeros(table.count, dtype=np.bool_)
    for number, item in enumerate(table.objects):
        rows = np.flatnonzero(table.object_index == number)
        pushers, ahead, outline = table.pushers[rows], direction[rows], item.outline
        contact = first_contact(outline, pushers, table.pusher_radius_m[rows])
        touches[rows] = np.isfinite(contact.travel_m)
        gap[rows] = np.maximum(outline.distance_m(pushers[:, :2]) - table.pusher_radius_m[rows], 0.0)
        lever = outline.centroid_m - pushers[:, :2]
        offset[rows] = np.abs(ahead[:, 0] * lever[:, 1] - ahead[:, 1] * lever[:, 0]) / outline.size_m
        angle[rows] = np.degrees(np.arccos(np.clip((ahead * contact.normal).sum(axis=1), 0.0, 1.0)))
        size[rows] = outline.size_m
    columns = (_MM * gap, offset, angle, _MM * table.pushers[:, 3], _MM * size, _MM * table.pusher_radius_m)
    values = {name: np.where(touches, column, np.nan) for name, column in zip(EDGES, columns, strict=True)}
    return Features(values, touches, size)


def bands(table: PushTable, found: Features) -> dict[str, dict[str, Mask]]:
    """Return the rows (n,) of every band that has pushes, by kind and name."""
    kinds: dict[str, dict[str, Mask]] = {SPREAD: {"touching": found.touches, "missing": ~found.touches}}
    for kind, edges in EDGES.items():
        place = np.digitize(found.values[kind] - _EDGE_SLACK, edges)
        kinds[kind] = {
            _name(low, high): found.touches & (np.clip(place, 1, len(edges) - 1) == number)
            for number, (low, high) in enumerate(pairwise(edges), start=1)
        }
    family = table.labels.get(FAMILY)
    if family is not None:
        kinds[FAMILY] = {name: found.touches & family.equal(name) for name in family.values}
    return {kind: {name: rows for name, rows in groups.items() if rows.any()} for kind, groups in kinds.items()}


def _name(low: float, high: float) -> str:
    return f"{low:g} and more" if np.isinf(high) else f"{low:g} to {high:g}"
