"""Findings about a table of pushes: one function per check, from arrays to findings.

Limits come from recorded pushes of eleven steel shapes (Yu, Bauza, Fazeli, Rodriguez, IROS 2016), which pass every
check. A few faulty rows are a warning. From ``MANY`` on they are an error, because training would learn them.
"""

from collections.abc import Iterable, Iterator
from typing import Final

import numpy as np
import numpy.typing as npt

from service.pushing.outlines import Outline
from service.pushing.poses import DoubleArray
from training.inspection.findings import DatasetFinding, Severity
from training.inspection.tables.frames import END_INSIDE_M, PULL_M, SLACK, SLACK_M, START_INSIDE_M
from training.inspection.tables.geometry import PushGeometry, Rows, rows_by_object
from training.omnipush.object_identity import counted, shortened
from training.tables.push_table import PushTable

MANY: Final = 0.01  # share of the pushes
DEEP_M: Final = 0.01  # of a push that is left at the contact, so that it must move the object
STILL_WRONG: Final = 0.75  # of an object's deep pushes
FEW_DEEP: Final = 4
FEW_PUSHES: Final = 10  # of one object
FEW_OBJECTS: Final = 10
SCATTER_M: Final = 0.015  # median of two pushes from the same start. Recorded pushes have 1.4 mm.
SCATTER_RAD: Final = 0.26  # recorded: 1.3 degrees
FEWEST_PAIRS: Final = 10
_PLACE_M: Final = 0.001  # starts within it are the same start
_HEADING_RAD: Final = 0.02
_SHOWN: Final = 5  # rows of a finding


def odd_pushes(where: str, table: PushTable, geometry: PushGeometry) -> Iterator[DatasetFinding]:
    """Find single pushes that are impossible: inside the object, pulling, too far, or without contact."""
    inside, end_inside, limit = START_INSIDE_M * 1e3, END_INSIDE_M * 1e3, PULL_M * 1e3
    too_far = geometry.motion_m > SLACK * table.pushers[:, 3] + SLACK_M
    for code, mask, text in (
        ("starts-inside", geometry.start_m < -START_INSIDE_M, f"start over {inside:.0f} mm inside the object"),
        (
            "ends-inside",
            geometry.end_m < -END_INSIDE_M,
            f"end over {end_inside:.0f} mm inside the object as it then lies",
        ),
        ("moved-untouched", geometry.moved & ~geometry.reaches, "moved the object, but the tip passes by its outline"),
        (
            "pulls",
            geometry.along_m < -PULL_M,
            f"moved the object over {limit:.0f} mm against the direction of the push",
        ),
        ("too-far", too_far, "moved the centroid farther than the push is long"),
    ):
        if mask.any():
            share = float(mask.mean())
            severity = Severity.ERROR if share > MANY else Severity.WARNING
            text = f"{mask.sum()} of {table.count} pushes {text} ({rows_of(mask)}); check or remove them"
            yield DatasetFinding(severity, code, where, text)


def odd_motion(where: str, table: PushTable, geometry: PushGeometry) -> Iterator[DatasetFinding]:
    """Find objects that hardly ever moved, although the tip goes far beyond the contact."""
    deep = geometry.travel_m < table.pushers[:, 3] - DEEP_M
    pushed = np.bincount(table.object_index[deep], minlength=len(table.objects))
    still = np.bincount(table.object_index[deep & ~geometry.moved], minlength=len(table.objects))
    names = [
        table.objects[number].name
        for number in np.flatnonzero((pushed >= FEW_DEEP) & (still > STILL_WRONG * pushed)).tolist()
    ]
    if names:
        text = f"hardly any motion, as if not tracked, in {counted(names)}; check its outcomes, or remove it"
        yield DatasetFinding(Severity.ERROR, "objects-still", where, text)
    if not geometry.reaches.mean() > 0.5:
        text = (
            f"{100 * (1 - geometry.reaches.mean()):.0f} % of the pushes pass by the outline; "
            "a model learns little from them, so keep fewer"
        )
        yield DatasetFinding(Severity.WARNING, "no-contact", where, text)


def odd_repeats(where: str, table: PushTable) -> Iterator[DatasetFinding]:
    """Find rows that occur twice."""
    twice = _repeated(table)
    if twice.any():
        repeat = "push repeats" if twice.sum() == 1 else "pushes repeat"
        text = f"{twice.sum()} {repeat} an earlier one to the last digit ({rows_of(twice)}); those count double"
        yield DatasetFinding(Severity.WARNING, "pushes-twice", where, text)


def odd_scatter(where: str, table: PushTable) -> Iterator[DatasetFinding]:
    """Find pushes from the same start that end too far apart, or at the same digits."""
    pairs = same_starts(table.select(~_repeated(table)))
    if len(pairs) < FEWEST_PAIRS:
        return
    distance, turn = np.median(np.hypot(pairs[:, 0], pairs[:, 1])), np.median(np.abs(pairs[:, 2]))
    if distance > SCATTER_M or turn > SCATTER_RAD:
        text = (
            f"{len(pairs)} pairs of pushes from the same start end {1e3 * distance:.1f} mm and {np.degrees(turn):.1f} "
            "degrees apart at the median, where recorded ones have 1.4 mm and 1.3 degrees; "
            "check that outcomes are beside their own pushes"
        )
        yield DatasetFinding(Severity.ERROR, "scatter", where, text)
    elif distance < 1e-6:
        text = (
            f"{len(pairs)} pairs of pushes from the same start have the same outcome, as if computed; "
            "a model would be too sure of itself"
        )
        yield DatasetFinding(Severity.WARNING, "scatter", where, text)


def _repeated(table: PushTable) -> npt.NDArray[np.bool_]:
    """Return a mask, (n,), of the rows that are equal to an earlier one."""
    keys = [table.object_index, table.surface_index, table.pusher_radius_m, *table.pushers.T, *table.outcomes.T]
    order = np.lexsort(keys)
    same = np.logical_and.reduce([key[order[1:]] == key[order[:-1]] for key in keys])
    twice = np.zeros(table.count, dtype=np.bool_)
    twice[order[1:][same]] = True
    return twice


def same_starts(table: PushTable) -> DoubleArray:
    """Return the differences (pairs, 3) between outcomes of pushes of an object from the same start.

    Starts are the same within a cell of 1 mm, 20 mrad and 1 mm of length. Pushes of a cell are compared in order.
    """
    cells = np.column_stack([table.pushers[:, :2], table.pushers[:, 3]]) / _PLACE_M
    keys = np.column_stack(
        [table.object_index, table.surface_index, np.rint(cells), np.rint(table.pushers[:, 2] / _HEADING_RAD)]
    )
    order = np.lexsort(keys.T)
    same = (keys[order[1:]] == keys[order[:-1]]).all(axis=1)
    difference = table.outcomes[order[1:]] - table.outcomes[order[:-1]]
    return np.asarray(difference[same])


def odd_objects(where: str, table: PushTable) -> Iterator[DatasetFinding]:
    """Find objects with the same outline or the same pushes, objects without pushes, and too few to learn from."""
    groups = rows_by_object(table)
    used = {number for number, _ in groups}
    unused = [item.name for number, item in enumerate(table.objects) if number not in used]
    if unused:
        text = f"no pushes of {counted(unused)} in the file of outlines; remove them, or check their names"
        yield DatasetFinding(Severity.WARNING, "objects-unused", where, text)
    for names in _alike(
        ((table.objects[number].name, outline_key(table.objects[number].outline)) for number, _ in groups)
    ):
        text = (
            f"{shortened(names)} have the same outline; if they are one object, give them one name, or a split by "
            "object tests on an object that was trained on"
        )
        yield DatasetFinding(Severity.WARNING, "same-outline", where, text)
    for names in _alike((table.objects[number].name, _pushes_key(table, rows)) for number, rows in groups):
        text = f"{shortened(names)} have the same pushes under different names; remove all but one"
        yield DatasetFinding(Severity.ERROR, "same-pushes", where, text)
    yield from _too_few(where, table, groups)


def outline_key(outline: Outline) -> bytes:
    """Return a key that is equal for equal outlines in any place, at any turn, from any first corner."""
    edges = outline.edges
    lengths = np.hypot(edges[:, 0], edges[:, 1])
    after = np.roll(edges, -1, axis=0)
    turns = np.arctan2(edges[:, 0] * after[:, 1] - edges[:, 1] * after[:, 0], (edges * after).sum(axis=1))
    steps = [tuple(step) for step in np.rint(np.column_stack([lengths * 1e4, turns * 1e2])).astype(int).tolist()]
    first = _least_rotation(steps)
    return repr(steps[first:] + steps[:first]).encode()


def _least_rotation(steps: list[tuple[int, ...]]) -> int:
    """Return the place from which a cycle is first in order: two candidates, of which the later one gives way."""
    count = len(steps)
    first, second, same = 0, 1, 0
    while second < count and first < count and same < count:
        here, there = steps[(first + same) % count], steps[(second + same) % count]
        if here == there:
            same += 1
            continue
        if here > there:
            first += same + 1
        else:
            second += same + 1
        if first == second:
            second += 1
        same = 0
    return min(first, second)


def rows_of(mask: npt.NDArray[np.bool_]) -> str:
    """Return the first rows of a mask, counted from 1 as in a table without its header."""
    rows = np.flatnonzero(mask)
    shown = ", ".join(str(row + 1) for row in rows[:_SHOWN].tolist())
    return f"row{'s' if len(rows) > 1 else ''} {shown}{' ...' if len(rows) > _SHOWN else ''}"


def _too_few(where: str, table: PushTable, groups: list[tuple[int, Rows]]) -> Iterator[DatasetFinding]:
    known = 100.0 / np.sqrt(table.count)
    if len(groups) < FEW_OBJECTS:
        text = (
            f"{table.count} pushes of {len(groups)} {'object' if len(groups) == 1 else 'objects'}: enough to score a "
            f"model on them, with a mean error known to about {known:.0f} %, and not to train one for other objects"
        )
        yield DatasetFinding(Severity.WARNING, "few-objects", where, text)
    few = [f"{table.objects[number].name} ({len(rows)})" for number, rows in groups if len(rows) < FEW_PUSHES]
    if few:
        text = (
            f"fewer than {FEW_PUSHES} pushes of {counted(few)}; figures of one object are then known to a third at best"
        )
        yield DatasetFinding(Severity.WARNING, "few-pushes", where, text)


def _alike(keys: Iterable[tuple[str, bytes]]) -> Iterator[list[str]]:
    groups: dict[bytes, list[str]] = {}
    for name, key in keys:
        groups.setdefault(key, []).append(name)
    return (names for names in groups.values() if len(names) > 1)


def _pushes_key(table: PushTable, rows: Rows) -> bytes:
    values = np.column_stack([table.pushers[rows], table.outcomes[rows]])
    return values[np.lexsort(values.T)].tobytes()
