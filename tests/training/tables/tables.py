"""Tables of pushes for tests: a small valid one, its files as text, and the fault in which reading ends."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pytest

from service.errors import DataError
from service.pushing.first_contact import first_contact
from service.pushing.mechanics import push
from service.pushing.outlines import Outline
from service.pushing.poses import DoubleArray, wrap_angle
from training.tables.push_table import DEFAULT_PUSHER_RADIUS_M, PushTable, TableObject
from training.tables.reading import read_table

WEDGE = ((0.06, 0.01), (0.05, 0.04), (-0.03, 0.04), (-0.06, -0.03), (-0.01, -0.02))  # of no symmetry
BOX = ((0.05, 0.03), (-0.05, 0.03), (-0.05, -0.03), (0.05, -0.03))
PUSH: Mapping[str, object] = {
    "object": "box",
    "pusher_x_m": -0.06,
    "pusher_y_m": 0.01,
    "push_angle_rad": 0.0,
    "push_length_m": 0.05,
    "object_x_m": 0.04,
    "object_y_m": 0.001,
    "object_yaw_rad": -0.3,
}


def csv_text(rows: Sequence[Mapping[str, object]]) -> str:
    """Return rows as CSV, with the columns of the first row."""
    names = list(rows[0])
    return "\n".join([",".join(names), *(",".join(str(row[name]) for name in names) for row in rows)]) + "\n"


def corner_rows(name: str = "box", corners: Sequence[tuple[float, float]] = BOX) -> list[dict[str, object]]:
    """Return the rows of one object."""
    return [{"object": name, "corner": number, "x_m": x, "y_m": y} for number, (x, y) in enumerate(corners)]


def write_folder(
    folder: Path,
    pushes: Sequence[Mapping[str, object]] = (PUSH,),
    corners: Sequence[Mapping[str, object]] | None = None,
) -> Path:
    """Write a table as CSV files and return the folder."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "pushes.csv").write_text(csv_text(pushes))
    (folder / "objects.csv").write_text(csv_text(corners or corner_rows()))
    return folder


def pushed_table(objects: Mapping[str, Outline], count: int = 40, seed: int = 0) -> PushTable:
    """Return pushes of objects by quasi-static mechanics, with the noise of a tracker: a table without a fault."""
    rng = np.random.default_rng(seed)
    pushers, outcomes = [], []
    for outline in objects.values():
        starts = _starts(outline, count, rng)
        pushers.append(starts)
        noise = rng.normal(0.0, 1.0, (count, 3)) * (0.0005, 0.0005, 0.005)
        outcomes.append(push(outline, starts, DEFAULT_PUSHER_RADIUS_M) + noise)
    index = np.repeat(np.arange(len(objects)), count)
    return PushTable(
        objects=tuple(TableObject(name, outline) for name, outline in objects.items()),
        object_index=index,
        pushers=np.concatenate(pushers),
        outcomes=np.concatenate(outcomes),
        pusher_radius_m=np.full(len(index), DEFAULT_PUSHER_RADIUS_M),
        surfaces=("table",),
        surface_index=np.zeros(len(index), dtype=np.int64),
        source="a test",
        digest="0",
    )


def _starts(outline: Outline, count: int, rng: np.random.Generator) -> DoubleArray:
    """Return pushers, (count, 4), that start beside the outline and aim at its inside."""
    found: list[list[float]] = []
    x_m, y_m = outline.centroid_m
    while len(found) < count:
        angle, aim = rng.uniform(-math.pi, math.pi), rng.normal(0.0, 0.15)
        start = np.array([x_m + 0.2 * math.cos(angle), y_m + 0.2 * math.sin(angle)])
        heading = wrap_angle(angle + math.pi + aim)
        far = np.array([[*start, heading, 1.0]])
        travel = float(first_contact(outline, far, DEFAULT_PUSHER_RADIUS_M).travel_m[0]) - 0.002
        if math.isfinite(travel):
            x, y = start + travel * np.array([math.cos(heading), math.sin(heading)])
            found.append([x, y, heading, 0.05])
    return np.array(found)


def fault_of(path: Path) -> str:
    """Return the one line in which reading a table ends, behind the name of the file."""
    with pytest.raises(DataError) as caught:
        read_table(path)
    (line,) = str(caught.value).splitlines()
    return line.removeprefix(f"{path}: ")
