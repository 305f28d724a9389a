"""Table of pushes in memory: objects with outlines, and columns of pushes.

All numbers are SI units, in the frame of the object before the push, as its outline is.
"""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
import numpy.typing as npt

from service.pushing.outlines import Outline
from service.pushing.poses import DoubleArray

IndexArray = npt.NDArray[np.int64]
DEFAULT_PUSHER_RADIUS_M: Final = 0.00475  # of a table without the column: the steel tip of Omnipush
UNSTATED: Final = "unstated"  # the surface of a table without the column


@dataclass(frozen=True)
class TableObject:
    """Object of a table: its name and outline. A value of None is not known."""

    name: str
    outline: Outline
    centre_of_mass_m: tuple[float, float] | None = None
    mass_kg: float | None = None
    friction: float | None = None  # of pusher and object


@dataclass(frozen=True)
class TextColumn:
    """Column of texts with few distinct values: the values, and the index of each row into them, (n,)."""

    values: tuple[str, ...]
    index: IndexArray

    def select(self, rows: npt.NDArray[np.bool_] | IndexArray) -> "TextColumn":
        """Return these rows, with the values that still occur, in the same order."""
        used, index = np.unique(self.index[rows], return_inverse=True)
        return TextColumn(tuple(self.values[number] for number in used.tolist()), index.astype(np.int64))

    def equal(self, value: str) -> npt.NDArray[np.bool_]:
        """Return a mask, (n,), of the rows that hold a value."""
        wanted = self.values.index(value) if value in self.values else -1
        return np.asarray(self.index == wanted)


@dataclass(frozen=True)
class PushTable:
    """Table of n pushes.

    Attributes:
        objects: the objects, in the order of their file. ``object_index``, (n,), points into them.
        pushers: (n, 4), x_m, y_m, angle_rad, length_m. The start is the centre of the round tip.
        outcomes: (n, 3), the pose of the object after the push: x_m, y_m, yaw_rad.
        pusher_radius_m: (n,).
        surfaces: names of the surfaces. ``surface_index``, (n,), points into them.
        source: the origin that the table declares.
        digest: sha256 of the content, equal for CSV and Parquet.
        peers: predictions of other models for the same pushes, (n, 3), by their names.
        labels: other columns with few distinct values, to split by.
        ignored: columns that were not read.
    """

    objects: tuple[TableObject, ...]
    object_index: IndexArray
    pushers: DoubleArray
    outcomes: DoubleArray
    pusher_radius_m: DoubleArray
    surfaces: tuple[str, ...]
    surface_index: IndexArray
    source: str
    digest: str
    peers: Mapping[str, DoubleArray] = field(default_factory=dict)
    labels: Mapping[str, TextColumn] = field(default_factory=dict)
    ignored: tuple[str, ...] = ()

    @property
    def count(self) -> int:
        """Number of pushes."""
        return len(self.object_index)

    @property
    def text_columns(self) -> dict[str, TextColumn]:
        """Columns to split by: object, surface and the labels."""
        names = TextColumn(tuple(item.name for item in self.objects), self.object_index)
        return {"object": names, "surface": TextColumn(self.surfaces, self.surface_index), **self.labels}

    def select(self, rows: npt.NDArray[np.bool_] | IndexArray) -> "PushTable":
        """Return some pushes, by a mask (n,) or by indices, with the objects and surfaces that occur among them.

        Source and digest stay those of the whole table.
        """
        used, object_index = np.unique(self.object_index[rows], return_inverse=True)
        surface = TextColumn(self.surfaces, self.surface_index).select(rows)
        return replace(
            self,
            objects=tuple(self.objects[number] for number in used.tolist()),
            object_index=object_index.astype(np.int64),
            pushers=self.pushers[rows],
            outcomes=self.outcomes[rows],
            pusher_radius_m=self.pusher_radius_m[rows],
            surfaces=surface.values,
            surface_index=surface.index,
            peers={name: values[rows] for name, values in self.peers.items()},
            labels={name: column.select(rows) for name, column in self.labels.items()},
        )


def content_digest(table: PushTable) -> str:
    """Compute the sha256 of objects, surfaces and pushes. Peers, labels and the source do not count."""
    digest = hashlib.sha256()
    for item in table.objects:
        digest.update(repr((item.name, item.centre_of_mass_m, item.mass_kg, item.friction)).encode())
        digest.update(np.ascontiguousarray(item.outline.corners, dtype="<f8").tobytes())
    digest.update(repr(table.surfaces).encode())
    for values in (table.object_index, table.surface_index):
        digest.update(np.ascontiguousarray(values, dtype="<i8").tobytes())
    for numbers in (table.pushers, table.outcomes, table.pusher_radius_m):
        digest.update(np.ascontiguousarray(numbers, dtype="<f8").tobytes())
    return digest.hexdigest()
