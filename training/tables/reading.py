"""Reading of a table of pushes from CSV or Parquet files."""

import difflib
import math
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from service.pushing.poses import DoubleArray, wrap_angles
from training.omnipush.declaration import read_declared
from training.tables.columns import Columns, Wanted, groups_of, read_columns, read_header, require
from training.tables.files import TableFile, find_files
from training.tables.objects import name_column, read_objects
from training.tables.push_table import (
    DEFAULT_PUSHER_RADIUS_M,
    UNSTATED,
    IndexArray,
    PushTable,
    TableObject,
    TextColumn,
    content_digest,
)

PUSHER: Final = ("pusher_x_m", "pusher_y_m", "push_angle_rad", "push_length_m")
OUTCOME: Final = ("object_x_m", "object_y_m", "object_yaw_rad")
RADIUS: Final = "pusher_radius_m"
SURFACE: Final = "surface"
POSE_SUFFIXES: Final = ("_x_m", "_y_m", "_yaw_rad")
UNKNOWN_SOURCE: Final = "pushes of undeclared origin"
MAX_SOURCE: Final = 200  # characters
MAX_PEERS: Final = 8
MAX_LABEL_COLUMNS: Final = 16
# Angles up to these are wrapped. Larger ones may be degrees, and are left for the check to find.
WRAPPED_ANGLE_RAD: Final = 4.0 * math.pi  # a heading less a yaw
WRAPPED_YAW_RAD: Final = 2.0 * math.pi


def read_table(path: Path, objects_file: Path | None = None) -> PushTable:
    """Read a table of pushes. Push angles of up to two turns, and yaws of up to one, are wrapped.

    Args:
        path: a folder with ``pushes.csv`` or ``pushes.parquet``, or such a file of any name.
        objects_file: the file of objects. By default ``objects.*`` or ``outlines.*`` beside the pushes.

    Raises:
        DataError: a file is missing, too large or broken. The message names it, the row and the column, and the cure.
    """
    pushes, corners = find_files(path, objects_file)
    pushes.check()
    objects = read_objects(corners)
    header = read_header(pushes)
    key = name_column(header.names)
    require(pushes, header, (key, *PUSHER, *OUTCOME))
    peers = tuple(groups_of(header.names, ("object", "pusher"), POSE_SUFFIXES))[:MAX_PEERS]
    predictions = tuple(peer + suffix for peer in peers for suffix in POSE_SUFFIXES)
    radius, surface = ((name,) if name in header.plain else () for name in (RADIUS, SURFACE))
    taken = {key, *PUSHER, *OUTCOME, *predictions, *radius, *surface}
    others = tuple(name for name in header.names if name and name not in taken)
    _check_misspelt(pushes, others)
    labels = tuple(name for name in others if name in header.plain)[:MAX_LABEL_COLUMNS]
    columns = read_columns(
        pushes, header, Wanted((*PUSHER, *OUTCOME, *radius, *predictions), (), (key, *surface), labels)
    )
    _check_positive(pushes, columns, ("push_length_m", *radius))
    surfaces = columns.texts.get(SURFACE, TextColumn((UNSTATED,), np.zeros(columns.rows, dtype=np.int64)))
    numbers = columns.numbers
    table = PushTable(
        objects=objects,
        object_index=_object_index(pushes, corners, columns.texts[key], objects, key),
        pushers=_poses((numbers[name] for name in PUSHER), WRAPPED_ANGLE_RAD),
        outcomes=_poses((numbers[name] for name in OUTCOME), WRAPPED_YAW_RAD),
        pusher_radius_m=numbers[RADIUS] if radius else np.full(columns.rows, DEFAULT_PUSHER_RADIUS_M),
        surfaces=surfaces.values,
        surface_index=surfaces.index,
        source=read_declared(pushes.path.parent, "source", UNKNOWN_SOURCE)[:MAX_SOURCE],
        digest="",
        peers={peer: np.column_stack([numbers[peer + suffix] for suffix in POSE_SUFFIXES]) for peer in peers},
        labels={name: columns.texts[name] for name in labels if name in columns.texts},
        ignored=(*(name for name in others if name not in labels), *columns.dropped),
    )
    return replace(table, digest=content_digest(table))


def _poses(columns: Iterable[DoubleArray], limit_rad: float) -> DoubleArray:
    """Return columns side by side, with angles up to the limit, in the third, wrapped to (-pi, pi]."""
    found = np.column_stack(list(columns))
    found[:, 2] = np.where(np.abs(found[:, 2]) <= limit_rad, wrap_angles(found[:, 2]), found[:, 2])
    return found


def _check_misspelt(file: TableFile, names: tuple[str, ...]) -> None:
    """Refuse a column that means an optional one by another name: without it, its default would be taken."""
    for name in names:
        folded = name.lower().strip()
        for optional, word in ((RADIUS, "radius"), (SURFACE, SURFACE)):
            if word == folded or (word == "radius" and word in folded):
                raise file.fault(f"has a column {name!r}, and none called {optional}; rename it to {optional}")


def _check_positive(file: TableFile, columns: Columns, names: tuple[str, ...]) -> None:
    for name in names:
        wrong = columns.numbers[name] <= 0.0
        if wrong.any():
            row = int(wrong.argmax())
            advice = "a positive number" + ("; push_angle_rad says which way" if name == "push_length_m" else "")
            raise file.fault_at(row, name, f"{columns.numbers[name][row]:g}", advice)


def _object_index(
    file: TableFile, corners: TableFile, column: TextColumn, objects: tuple[TableObject, ...], key: str
) -> IndexArray:
    """Return the index of each push into the objects, (n,)."""
    places = {item.name: number for number, item in enumerate(objects)}
    found = np.array([places.get(name, -1) for name in column.values], dtype=np.int64)[column.index]
    if found.min() < 0:
        row = int(found.argmin())
        name = column.values[column.index[row]]
        near = difflib.get_close_matches(name, places, n=1)
        advice = f"{near[0]!r} perhaps" if near else f"{objects[0].name!r} is one; or add the outline there"
        raise file.fault_at(row, key, f"{name!r}, which has no outline in {corners.path}", f"a name in it: {advice}")
    return found
