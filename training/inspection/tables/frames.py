"""Units and frames of a table: numbers that are not metres and radians, and poses that are not in the outline's frame.

A frame is judged by the share of pushes that are possible in it: the tip starts outside, and if the object moved, the
tip comes near its outline and ends outside it. If few pushes are possible as given, simple other readings of the same
numbers are tried, and the one that fits is named.
"""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import numpy.typing as npt

from service.pushing.poses import DoubleArray, wrap_angles
from training.inspection.findings import DatasetFinding, Severity
from training.inspection.tables.geometry import PushGeometry, centroid_motion, push_geometry, rows_by_object
from training.tables.push_table import PushTable
from training.tables.reading import WRAPPED_ANGLE_RAD, WRAPPED_YAW_RAD

START_INSIDE_M: Final = 0.003  # overlap at the start. Recorded pushes have 0.3 mm, and 3 mm once in 2,000.
END_INSIDE_M: Final = 0.008  # overlap at the end. Recorded pushes have up to 7.4 mm.
PULL_M: Final = 0.005  # against the push. Recorded pushes have up to 3 mm, but for one in 10,000.
SLACK: Final = 1.05  # of the push length, and 3 mm
SLACK_M: Final = 0.003
BESIDE_M: Final = 0.006  # between tip and object after a push. Others slid off.
FITS: Final = 0.95  # share of possible pushes of a frame that is not questioned. Recorded pushes have 0.999.
WRONG: Final = 0.8
BESIDE: Final = 0.6  # share beside the object likewise. Recorded pushes have 0.88.
BETTER: Final = 0.08  # by which another frame must be better
SAMPLE: Final = 4000  # pushes on which frames are tried
SAMPLE_OBJECTS: Final = 200
_FAR_OFF: Final = 15.0  # times the expected ratio of two lengths: no longer the same unit
LONGEST_M: Final = 1.0  # a plausible push
FEWEST: Final = 3  # pushes that fit another frame better
Poses = tuple[DoubleArray, DoubleArray]
Reading = Callable[[DoubleArray, DoubleArray], Poses]


@dataclass(frozen=True)
class _Fit:
    """Shares of pushes that are possible in a frame, and after which the tip is beside an object that it moved."""

    possible: float
    beside: float


def odd_units(where: str, table: PushTable) -> Iterator[DatasetFinding]:
    """Find lengths that are millimetres or centimetres, and angles that are degrees, by the size of the outlines."""
    extent = np.array([item.outline.extent_m for item in table.objects])[table.object_index]
    centroid = np.array([item.outline.centroid_m for item in table.objects])[table.object_index]
    start = np.hypot(*(table.pushers[:, :2] - centroid).T)
    motion = np.hypot(table.outcomes[:, 0], table.outcomes[:, 1])
    lengths = {  # columns, their usual ratio to the extent of the outline
        "pusher_x_m and pusher_y_m": (start / extent, 0.8),
        "push_length_m": (table.pushers[:, 3] / extent, 0.5),
        "pusher_radius_m": (table.pusher_radius_m / extent, 0.06),
    }
    units = [
        _unit(where, names, float(np.median(ratios)) / usual)
        for names, (ratios, usual) in lengths.items()
        if len(ratios) and np.median(ratios) > _FAR_OFF * usual
    ]
    for name, angles, most in (
        ("push_angle_rad", table.pushers[:, 2], WRAPPED_ANGLE_RAD),
        ("object_yaw_rad", table.outcomes[:, 2], WRAPPED_YAW_RAD),
    ):
        if np.mean(np.abs(angles) > most) > 0.01:
            text = (
                f"{name} looks like degrees (up to {np.abs(angles).max():.4g}); expected radians: multiply by pi / 180"
            )
            units.append(DatasetFinding(Severity.ERROR, "units", where, text))
    length_m = float(np.median(table.pushers[:, 3]))
    if not units and length_m > LONGEST_M:
        text = f"outlines and pushes look like centimetres (pushes of {length_m:.3g} m); expected metres: divide by 100"
        units.append(DatasetFinding(Severity.ERROR, "units", where, text))
    yield from units
    if not units:
        yield from _odd_outcome_units(where, table, motion)


def _unit(where: str, names: str, ratio: float) -> DatasetFinding:
    unit, factor = ("centimetres", 100) if ratio < 10 * math.sqrt(1000.0) else ("millimetres", 1000)
    look = "look" if " and " in names else "looks"
    text = f"{names} {look} like {unit} beside the outlines; expected metres: divide them by {factor}"
    return DatasetFinding(Severity.ERROR, "units", where, text)


def _odd_outcome_units(where: str, table: PushTable, motion: DoubleArray) -> Iterator[DatasetFinding]:
    """Find outcomes that are farther off than any pushed object: in a smaller unit, or in world coordinates."""
    if np.mean(motion > 1.5 * table.pushers[:, 3] + 0.02) < 0.5:
        return
    sample = _sample(table)
    name = "object_x_m and object_y_m"
    for unit, factor in (("millimetres", 1000), ("centimetres", 100)):
        scaled = replace(sample, outcomes=sample.outcomes / [factor, factor, 1])
        if _fit(scaled).beside > 0.5:
            text = f"{name} look like {unit}; expected metres: divide them by {factor}"
            yield DatasetFinding(Severity.ERROR, "units", where, text)
            return
    text = (
        f"{name} look like world coordinates: they are {np.median(motion):.3g} m from 0 at the median, after pushes of "
        f"{np.median(table.pushers[:, 3]):.3g} m; expected the pose after the push in the object's frame before it"
    )
    yield DatasetFinding(Severity.ERROR, "frame", where, text)


def possible(table: PushTable, geometry: PushGeometry) -> npt.NDArray[np.bool_]:
    """Return a mask, (n,), of the pushes that no law of geometry forbids."""
    pushed = (
        geometry.reaches
        & (geometry.end_m > -END_INSIDE_M)
        & (geometry.along_m > -PULL_M)
        & (geometry.motion_m < SLACK * table.pushers[:, 3] + SLACK_M)
    )
    return (geometry.start_m > -START_INSIDE_M) & (pushed | ~geometry.moved)


def odd_frames(where: str, table: PushTable, geometry: PushGeometry) -> Iterator[DatasetFinding]:
    """Find poses that do not fit the outlines, and name the simple other frame that fits, if there is one."""
    share = float(np.mean(possible(table, geometry)))
    sample = _sample(table)
    given = _fit(sample)
    if share >= FITS and given.beside >= BESIDE:
        return
    found = {name: _fit(_read(sample, reading)) for name, reading in _readings(sample).items()}
    best = max(found, key=lambda name: found[name].beside)
    fits = found[best].beside >= given.beside + max(BETTER, FEWEST / sample.count) and found[best].possible >= WRONG
    if share >= FITS and not fits:
        return
    text = (
        f"{100 * (1 - share):.0f} % of the pushes are impossible beside the outlines (the tip starts inside, pulls, "
        "passes by an object that moved, or ends inside)"
    )
    if share >= FITS:
        text = f"after {100 * (1 - given.beside):.0f} % of the pushes the tip is not beside the object"
    if fits:
        text += f"; {100 * found[best].possible:.0f} % fit if {best}"
    else:
        text += (
            "; no simple other frame fits either: check that rows are not shuffled, and that poses and outlines are "
            "in the object's frame before the push"
        )
    severity = Severity.ERROR if fits or share < WRONG else Severity.WARNING
    yield DatasetFinding(severity, "frame", where, text)


def _sample(table: PushTable) -> PushTable:
    """Return an even sample of the pushes, of an even sample of the objects."""
    used = np.unique(table.object_index)
    chosen = used[:: max(1, -(-len(used) // SAMPLE_OBJECTS))]
    rows = np.flatnonzero(np.isin(table.object_index, chosen))
    return table.select(rows[:: max(1, -(-len(rows) // SAMPLE))])


def _fit(table: PushTable) -> _Fit:
    geometry = push_geometry(table)
    fitting = possible(table, geometry)
    beside = np.abs(geometry.end_m) < BESIDE_M
    return _Fit(float(np.mean(fitting)), float(np.mean(fitting & (beside | ~geometry.moved))))


def _read(table: PushTable, reading: Reading) -> PushTable:
    pushers, outcomes = reading(table.pushers.copy(), table.outcomes.copy())
    pushers[:, 2], outcomes[:, 2] = wrap_angles(pushers[:, 2]), wrap_angles(outcomes[:, 2])
    return replace(table, pushers=pushers, outcomes=outcomes)


def _readings(table: PushTable) -> Mapping[str, Reading]:
    """Return other readings of the poses by their description."""
    index = table.object_index
    centroid = np.array([item.outline.centroid_m for item in table.objects])[index]
    low, high = (
        np.array([limit(item.outline.corners, axis=0) for item in table.objects])[index] for limit in (np.min, np.max)
    )

    def angle(turned: Callable[[DoubleArray], DoubleArray]) -> Reading:
        def read(pushers: DoubleArray, outcomes: DoubleArray) -> Poses:
            pushers[:, 2] = turned(pushers[:, 2])
            return pushers, outcomes

        return read

    def shifted(by_m: DoubleArray) -> Reading:
        """Move starts and outcomes into a frame whose origin lies elsewhere; a turn is about the new origin."""

        def read(pushers: DoubleArray, outcomes: DoubleArray) -> Poses:
            pushers[:, :2] += by_m
            outcomes[:, :2] += by_m - _turned(by_m, outcomes[:, 2])
            return pushers, outcomes

        return read

    return {
        "push_angle_rad points from the object to the pusher: add pi": angle(lambda a: a + math.pi),
        "push_angle_rad turns clockwise: change its sign": angle(np.negative),
        "push_angle_rad is measured from the y axis, clockwise: use pi / 2 minus it": angle(lambda a: math.pi / 2 - a),
        "push_angle_rad is measured from the y axis: add pi / 2": angle(lambda a: a + math.pi / 2),
        "the y axis is flipped: change the sign of y and of the angles of the pushes": _linear(1, 0, 0, -1),
        "the x axis is flipped: change the sign of x and take pi minus the angles": _linear(-1, 0, 0, 1),
        "pusher_y_m and push_angle_rad change their signs": lambda pushers, outcomes: (
            pushers * [1, -1, -1, 1],
            outcomes,
        ),
        "x and y are swapped": _linear(0, 1, 1, 0),
        "the poses are turned by 90 degrees against the outlines": _linear(0, -1, 1, 0),
        "the poses are turned by 180 degrees against the outlines": _linear(-1, 0, 0, -1),
        "the poses are turned by 270 degrees against the outlines": _linear(0, 1, -1, 0),
        "the poses are about the centroid: subtract it from the corners": shifted(centroid),
        "the poses are about the middle of the box around the outline: subtract it": shifted((low + high) / 2.0),
        "the poses are about the lower left corner of the box around the outline: subtract it": shifted(low),
        **_outcome_readings(table),
    }


def _outcome_readings(table: PushTable) -> Mapping[str, Reading]:
    """Return other readings of the outcomes alone, by their description."""

    def signs(x: float, y: float, yaw: float) -> Reading:
        return lambda pushers, outcomes: (pushers, outcomes * [x, y, yaw])

    def about_centroid(pushers: DoubleArray, outcomes: DoubleArray) -> Poses:
        for number, rows in rows_by_object(table):
            outline = table.objects[number].outline
            outcomes[rows, :2] -= centroid_motion(outline, outcomes[rows]) - outcomes[rows, :2]
        return pushers, outcomes

    def inverse(pushers: DoubleArray, outcomes: DoubleArray) -> Poses:
        outcomes[:, :2] = -_turned(outcomes[:, :2], -outcomes[:, 2])
        return pushers, outcomes * [1, 1, -1]

    return {
        "object_yaw_rad changes its sign": signs(1, 1, -1),
        "object_y_m and object_yaw_rad change their signs": signs(1, -1, -1),
        "object_x_m and object_y_m change their signs": signs(-1, -1, 1),
        "object_x_m and object_y_m are the motion of the centroid": about_centroid,
        "the outcomes are the pose before the push in the frame after it: invert them": inverse,
        "object_x_m and object_y_m are swapped": lambda pushers, outcomes: (pushers, outcomes[:, [1, 0, 2]]),
    }


def _linear(a: float, b: float, c: float, d: float) -> Reading:
    """Return the reading that maps x, y to ax + by, cx + dy: a turn by right angles, or a reflection."""
    matrix = np.array([[a, c], [b, d]])
    sign = a * d - b * c

    def read(pushers: DoubleArray, outcomes: DoubleArray) -> Poses:
        heading = np.column_stack([np.cos(pushers[:, 2]), np.sin(pushers[:, 2])]) @ matrix
        pushers[:, :2] = pushers[:, :2] @ matrix
        pushers[:, 2] = np.arctan2(heading[:, 1], heading[:, 0])
        outcomes[:, :2] = outcomes[:, :2] @ matrix
        outcomes[:, 2] *= sign
        return pushers, outcomes

    return read


def _turned(vectors: DoubleArray, angles: DoubleArray) -> DoubleArray:
    """Return vectors (n, 2) turned by angles (n,)."""
    cos, sin = np.cos(angles), np.sin(angles)
    return np.column_stack([cos * vectors[:, 0] - sin * vectors[:, 1], sin * vectors[:, 0] + cos * vectors[:, 1]])
