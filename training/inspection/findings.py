"""What is odd about pushes: one function per question, arrays in, findings out.

An **error** is what makes training on the pushes wrong, or what the trainer refuses; a **warning** is what a person
should know and may accept. Limits are wide: they are to catch other units, other frames and broken copies, not to
judge a surface or a robot.
"""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

import numpy as np
import numpy.typing as npt

from training.inspection.statistics import Likeness, missed
from training.omnipush.files import Array
from training.omnipush.object_identity import by_kind, named, quarter_turns
from training.omnipush.published import published_normalisation

PUBLISHED_ROWS: Final = 250
ROWS_TOLERANCE: Final = 25
STD_RATIO_ODD: Final = 1.25  # or its inverse
STD_RATIO_WRONG: Final = 2.0
MEAN_SHIFT_ODD: Final = 0.25  # in published standard deviations
MEAN_SHIFT_WRONG: Final = 1.0
ENOUGH_PUSHES: Final = 500  # below that, statistics say little
UNWRAPPED_WRONG: Final = 0.01  # share of angles outside (-pi, pi]
MISSED_ODD: Final = 0.02
MISSED_WRONG: Final = 0.25
OBJECT_MISSED_WRONG: Final = 0.75
TWIN_TOLERANCE: Final = 1e-4  # published standard deviations: float32 files agree to 1e-6
_SAME_PLACE_M: Final = 1e-6
_ANGLE_SLACK_RAD: Final = 1e-6  # pi as float32 is above pi


class Severity(StrEnum):
    """Whether training on it would be wrong."""

    ERROR = "error"
    WARNING = "warning"


@dataclass(frozen=True)
class Finding:
    """One thing that is odd: a stable code, where it is, and a line that says what to do."""

    severity: Severity
    code: str
    where: str
    message: str


@dataclass(frozen=True)
class ObjectPushes:
    """One object as its files have it: SI units, float64 [pushes, 3] each."""

    descriptor: str
    pushers: Array
    outcomes: Array
    dtypes: tuple[str, ...]  # of its files


def odd_rows(where: str, objects: Sequence[ObjectPushes]) -> Iterator[Finding]:
    """Objects whose number of pushes is far from the published 250, and pushes that are there twice."""
    far = [
        f"{thing.descriptor} ({len(thing.pushers)})"
        for thing in objects
        if abs(len(thing.pushers) - PUBLISHED_ROWS) > ROWS_TOLERANCE
    ]
    if far:
        text = f"far from {PUBLISHED_ROWS} pushes in {named(far)}; fetch them again if the files were cut"
        yield Finding(Severity.WARNING, "rows-far-from-250", where, text)
    twice = {thing.descriptor: len(rows) - len(np.unique(rows, axis=0)) for thing, rows in _rows(objects)}
    names = [f"{descriptor} ({count})" for descriptor, count in twice.items() if count]
    if names:
        text = f"the same push more than once in {named(names)}; those count double"
        yield Finding(Severity.WARNING, "pushes-twice", where, text)


def odd_precision(where: str, objects: Sequence[ObjectPushes]) -> Iterator[Finding]:
    """Files that hold less than float32."""
    coarse = [thing.descriptor for thing in objects if "float16" in thing.dtypes]
    if coarse:
        text = f"float16, which rounds to 0.06 mm, in {named(coarse)}; fetch float32 or float64"
        yield Finding(Severity.WARNING, "precision", where, text)


def odd_twins(where: str, objects: Sequence[ObjectPushes]) -> Iterator[Finding]:
    """Objects that are there twice: as another turn of the same object, or with the pushes of another one."""
    there = {thing.descriptor: thing for thing in objects}
    for names in by_kind(there).values():
        for other in names[1:]:
            same = _same_pushes_turned(there[names[0]], there[other])
            content = "hold the same pushes" if same else "hold different pushes"
            text = (
                f"{names[0]} and {other} are the same kind of object, turned by whole sides, and {content}; "
                "keep the files of one of them"
            )
            yield Finding(Severity.ERROR, "object-twice", where, text)
    seen: dict[bytes, str] = {}
    for thing, rows in _rows(objects):
        first = seen.setdefault(rows[np.lexsort(rows.T)].tobytes(), thing.descriptor)
        if first != thing.descriptor:
            text = f"{first} and {thing.descriptor} hold the same pushes under two names; fetch both again"
            yield Finding(Severity.ERROR, "same-pushes", where, text)


def odd_contact(where: str, objects: Sequence[ObjectPushes]) -> Iterator[Finding]:
    """Pushes that moved nothing."""
    shares = {thing.descriptor: float(missed(thing.outcomes).mean()) for thing in objects}
    share = float(np.mean(missed(np.concatenate([thing.outcomes for thing in objects]))))
    if share > MISSED_ODD:
        severity = Severity.ERROR if share > MISSED_WRONG else Severity.WARNING
        text = f"{100 * share:.1f} % of the pushes moved nothing; look at their outcomes, or remove those pushes"
        yield Finding(severity, "no-contact", where, text)
    still = [descriptor for descriptor, share in shares.items() if share > OBJECT_MISSED_WRONG]
    if still:
        text = f"hardly any motion, as if not tracked, in {named(still)}; fetch them again"
        yield Finding(Severity.ERROR, "objects-still", where, text)


def odd_angles(where: str, pushers: Array, outcomes: Array) -> Iterator[Finding]:
    """Angles outside (-pi, pi], which would be other numbers than the service hands to a model."""
    for quantity, angles in (("push angles", pushers[:, 2]), ("object yaws", outcomes[:, 2])):
        share = float(np.mean(np.abs(angles) > math.pi + _ANGLE_SLACK_RAD))
        if share:
            severity = Severity.ERROR if share > UNWRAPPED_WRONG else Severity.WARNING
            text = f"{100 * share:.2f} % of the {quantity} are outside (-pi, pi]; wrap them"
            yield Finding(severity, "angles-unwrapped", where, text)


def odd_units(where: str, figures: Sequence[Likeness]) -> Iterator[Finding]:
    """Numbers that are no metres and radians: millimetres, centimetres, degrees, or normalised ones."""
    stds = np.array([figure.std for figure in figures])
    if stds.min() > 0.3 and stds.max() < 3.0:
        text = "the files named not_norm look normalised (deviations near 1); fetch the raw ones, or name these _norm"
        yield Finding(Severity.ERROR, "units", where, text)
        return
    for quantities, what in ((figures[0:2], "pusher positions"), (figures[3:5], "object positions")):
        scale = math.sqrt(float(np.prod([figure.ratio for figure in quantities])))
        for unit, factor in (("millimetres", 1000.0), ("centimetres", 100.0)):
            if factor / 3 < scale < factor * 3:
                text = f"the {what} look like {unit}; expected metres: divide them by {factor:.0f}"
                yield Finding(Severity.ERROR, "units", where, text)
                break
    for figure, what in ((figures[2], "push angles"), (figures[5], "object yaws")):
        if 180.0 / math.pi / 3 < figure.ratio < 180.0 / math.pi * 3:
            text = f"the {what} look like degrees; expected radians: multiply them by pi / 180"
            yield Finding(Severity.ERROR, "units", where, text)


def odd_statistics(where: str, figures: Iterable[Likeness], pushes: int) -> Iterator[Finding]:
    """Means and deviations far from the published ones."""
    if pushes < ENOUGH_PUSHES:
        text = f"{pushes} pushes are too few to compare their statistics with the published ones"
        yield Finding(Severity.WARNING, "statistics", where, text)
        return
    for figure in figures:
        spread = max(figure.ratio, 1.0 / figure.ratio if figure.ratio else math.inf)
        shift = abs(figure.mean - figure.published_mean) / figure.published_std
        if spread > STD_RATIO_ODD or shift > MEAN_SHIFT_ODD:
            wrong = spread > STD_RATIO_WRONG or shift > MEAN_SHIFT_WRONG
            text = (
                f"{figure.quantity} has mean {figure.mean:.4g} and deviation {figure.std:.4g}; published are "
                f"{figure.published_mean:.4g} and {figure.published_std:.4g}: check units and frame"
            )
            yield Finding(Severity.ERROR if wrong else Severity.WARNING, "statistics", where, text)


def odd_normalised(where: str, twins: Mapping[str, tuple[ObjectPushes, Array]]) -> Iterator[Finding]:
    """Normalised twins that are not the raw pushes under the published statistics; the trainer reads the raw ones.

    Args:
        where: the surface.
        twins: by descriptor, the raw object, and its normalised twin as [pushes, 6]: pushers, outcomes.
    """
    published = published_normalisation()
    other_pushes: list[str] = []
    other_statistics: list[str] = []
    for descriptor, (raw, twin) in twins.items():
        expected = np.column_stack(published.normalised(raw.pushers, raw.outcomes))
        if len(twin) == len(expected) and np.abs(twin - expected).max() <= TWIN_TOLERANCE:
            continue
        same = len(twin) == len(expected) and _affine(expected, twin)
        (other_statistics if same else other_pushes).append(descriptor)
    if other_pushes:
        text = (
            f"other pushes in the normalised twins than in the raw files of {named(other_pushes)}; "
            "fetch both again, or remove the twins if the raw files are the right ones"
        )
        yield Finding(Severity.ERROR, "twin-differs", where, text)
    if other_statistics:
        text = (
            f"normalised twins made with other statistics than the published ones of {named(other_statistics)}; "
            "the trainer reads the raw files"
        )
        yield Finding(Severity.WARNING, "twin-statistics", where, text)


def surface_findings(where: str, objects: Sequence[ObjectPushes], figures: Sequence[Likeness]) -> list[Finding]:
    """All that is odd about the pushes of one surface; wrong units are told once, not by their consequences."""
    pushers = np.concatenate([thing.pushers for thing in objects])
    outcomes = np.concatenate([thing.outcomes for thing in objects])
    units = list(odd_units(where, figures))
    return [
        *units,
        *([] if units else [*odd_angles(where, pushers, outcomes), *odd_statistics(where, figures, len(pushers))]),
        *odd_twins(where, objects),
        *odd_contact(where, objects),
        *odd_rows(where, objects),
        *odd_precision(where, objects),
    ]


def _rows(objects: Iterable[ObjectPushes]) -> Iterator[tuple[ObjectPushes, npt.NDArray[np.float32]]]:
    """Pushers and outcomes of each object side by side, as the trainer will see them."""
    for thing in objects:
        yield thing, np.column_stack([thing.pushers, thing.outcomes]).astype(np.float32)


def _same_pushes_turned(first: ObjectPushes, other: ObjectPushes) -> bool:
    """Whether the other object's positions are the first one's, turned as its descriptor is."""
    turns = quarter_turns(first.descriptor, other.descriptor) or 0
    if len(first.pushers) != len(other.pushers):
        return False
    cos, sin = round(math.cos(turns * math.pi / 2)), round(math.sin(turns * math.pi / 2))
    turn = np.array([[cos, sin], [-sin, cos]])  # row vectors
    return all(
        bool(np.allclose(mine[:, :2] @ turn, theirs[:, :2], rtol=0.0, atol=_SAME_PLACE_M))
        for mine, theirs in ((first.pushers, other.pushers), (first.outcomes, other.outcomes))
    )


def _affine(expected: Array, twin: Array) -> bool:
    """Whether each column of the twin is that of the expected one, shifted and scaled."""
    for wanted, found in zip(expected.T, twin.T, strict=True):
        model = np.column_stack([wanted, np.ones(len(wanted))])
        solution, *_ = np.linalg.lstsq(model, found, rcond=None)
        if len(wanted) <= model.shape[1] or np.abs(model @ solution - found).max() > TWIN_TOLERANCE:
            return False
    return True
