"""Findings about pushes: one function per check, from arrays to findings.

An **error** makes training on the pushes wrong, or is refused by the trainer. A **warning** is left to the user to
judge. Limits are wide: they catch other units, other frames and broken copies. They do not judge a surface or a robot.
"""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

import numpy as np
import numpy.typing as npt

from training.inspection.statistics import QUANTILES, MotionQuantiles, QuantityStatistics, missed, recorded_motion
from training.omnipush.files import Array
from training.omnipush.layout import SurfaceKind
from training.omnipush.object_identity import counted, group_by_object, quarter_turns
from training.omnipush.published import published_normalisation

PUBLISHED_ROWS: Final = 250
ROWS_TOLERANCE: Final = 25
STD_RATIO_ODD: Final = 1.25  # or its inverse
STD_RATIO_ODD_ELSEWHERE: Final = 1.5  # on another surface than ABS, of which the published statistics are
STD_RATIO_WRONG: Final = 2.0
MEAN_SHIFT_ODD: Final = 0.25  # in published standard deviations
MEAN_SHIFT_WRONG: Final = 1.0
ENOUGH_PUSHES: Final = 500  # fewer pushes are too few for statistics
UNWRAPPED_WRONG: Final = 0.01  # share of angles outside (-pi, pi]
MISSED_ODD: Final = 0.35  # of 11,132 raw recordings of Omnipush, 28.7 % did not move the object
MISSED_WRONG: Final = 0.60
OBJECT_MISSED_WRONG: Final = 0.75
DIFFERENT: Final = 0.15  # of a quantile of other pushes, unless the difference is small:
DIFFERENT_MM: Final = 0.5
DIFFERENT_DEG: Final = 0.5
TWIN_TOLERANCE: Final = 1e-4  # in published standard deviations; float32 files agree to 1e-6
_SAME_PLACE_M: Final = 1e-6
_ANGLE_SLACK_RAD: Final = 1e-6  # pi as float32 is above pi


class Severity(StrEnum):
    """Severity of a finding: an error makes training wrong, a warning does not."""

    ERROR = "error"
    WARNING = "warning"


@dataclass(frozen=True)
class DatasetFinding:
    """Finding about a dataset: a stable code, the place, and a line with the fault and the remedy."""

    severity: Severity
    code: str
    where: str
    message: str


class Judged:
    """Inspection as the verdict of its findings, of a folder or of a table."""

    findings: tuple[DatasetFinding, ...]

    def of(self, severity: Severity) -> list[DatasetFinding]:
        """Return the findings of one severity."""
        return [finding for finding in self.findings if finding.severity is severity]

    @property
    def fit_to_train_on(self) -> bool:
        """Verdict of the inspection: true without a finding that makes training wrong."""
        return not self.of(Severity.ERROR)


@dataclass(frozen=True)
class ObjectPushes:
    """Pushes of one object in SI units, float64 [pushes, 3] each, and the data types of its files."""

    descriptor: str
    pushers: Array
    outcomes: Array
    dtypes: tuple[str, ...]


def odd_rows(where: str, objects: Sequence[ObjectPushes]) -> Iterator[DatasetFinding]:
    """Find objects whose number of pushes is far from the published 250, and pushes that occur more than once."""
    far = [
        f"{item.descriptor} ({len(item.pushers)})"
        for item in objects
        if abs(len(item.pushers) - PUBLISHED_ROWS) > ROWS_TOLERANCE
    ]
    if far:
        text = f"far from {PUBLISHED_ROWS} pushes in {counted(far)}; fetch them again if the files were cut"
        yield DatasetFinding(Severity.WARNING, "rows-far-from-250", where, text)
    twice = {item.descriptor: len(rows) - len(np.unique(rows, axis=0)) for item, rows in _rows(objects)}
    names = [f"{descriptor} ({count})" for descriptor, count in twice.items() if count]
    if names:
        text = f"the same push more than once in {counted(names)}; those count double"
        yield DatasetFinding(Severity.WARNING, "pushes-twice", where, text)


def odd_precision(where: str, objects: Sequence[ObjectPushes]) -> Iterator[DatasetFinding]:
    """Find files in less than float32 precision."""
    coarse = [item.descriptor for item in objects if "float16" in item.dtypes]
    if coarse:
        text = f"float16, which rounds to 0.06 mm, in {counted(coarse)}; fetch float32 or float64"
        yield DatasetFinding(Severity.WARNING, "precision", where, text)


def odd_twins(where: str, objects: Sequence[ObjectPushes]) -> Iterator[DatasetFinding]:
    """Find objects that occur twice: under a turned descriptor, or with the pushes of another object."""
    there = {item.descriptor: item for item in objects}
    for names in group_by_object(there).values():
        for other in names[1:]:
            same = _same_pushes_turned(there[names[0]], there[other])
            content = "hold the same pushes" if same else "hold different pushes"
            text = (
                f"{names[0]} and {other} are the same object, turned by whole sides, and {content}; "
                "keep the files of one of them"
            )
            yield DatasetFinding(Severity.ERROR, "object-twice", where, text)
    seen: dict[bytes, str] = {}
    for item, rows in _rows(objects):
        first = seen.setdefault(rows[np.lexsort(rows.T)].tobytes(), item.descriptor)
        if first != item.descriptor:
            text = f"{first} and {item.descriptor} hold the same pushes under two names; fetch both again"
            yield DatasetFinding(Severity.ERROR, "same-pushes", where, text)


def odd_contact(where: str, objects: Sequence[ObjectPushes]) -> Iterator[DatasetFinding]:
    """Find pushes that did not move the object, and objects that hardly ever moved."""
    shares = {item.descriptor: float(missed(item.outcomes).mean()) for item in objects}
    share = float(np.mean(missed(np.concatenate([item.outcomes for item in objects]))))
    if share > MISSED_ODD:
        severity = Severity.ERROR if share > MISSED_WRONG else Severity.WARNING
        text = f"{100 * share:.1f} % of the pushes did not move the object; check their outcomes, or remove them"
        yield DatasetFinding(severity, "no-contact", where, text)
    still = [descriptor for descriptor, share in shares.items() if share > OBJECT_MISSED_WRONG]
    if still:
        text = f"hardly any motion, as if not tracked, in {counted(still)}; fetch them again"
        yield DatasetFinding(Severity.ERROR, "objects-still", where, text)


def odd_angles(where: str, pushers: Array, outcomes: Array) -> Iterator[DatasetFinding]:
    """Find angles outside (-pi, pi]. The service wraps angles before it calls a model."""
    for quantity, angles in (("push angles", pushers[:, 2]), ("object yaws", outcomes[:, 2])):
        share = float(np.mean(np.abs(angles) > math.pi + _ANGLE_SLACK_RAD))
        if share:
            severity = Severity.ERROR if share > UNWRAPPED_WRONG else Severity.WARNING
            text = f"{100 * share:.2f} % of the {quantity} are outside (-pi, pi]; wrap them"
            yield DatasetFinding(severity, "angles-unwrapped", where, text)


def odd_units(where: str, figures: Sequence[QuantityStatistics]) -> Iterator[DatasetFinding]:
    """Find numbers that are not metres and radians: millimetres, centimetres, degrees, or normalised ones."""
    stds = np.array([figure.std for figure in figures])
    if stds.min() > 0.3 and stds.max() < 3.0:
        text = "the files named not_norm look normalised (deviations near 1); fetch the raw ones, or name these _norm"
        yield DatasetFinding(Severity.ERROR, "units", where, text)
        return
    for quantities, name in ((figures[0:2], "pusher positions"), (figures[3:5], "object positions")):
        scale = math.sqrt(float(np.prod([figure.ratio for figure in quantities])))
        for unit, factor in (("millimetres", 1000.0), ("centimetres", 100.0)):
            if factor / 3 < scale < factor * 3:
                text = f"the {name} look like {unit}; expected metres: divide them by {factor:.0f}"
                yield DatasetFinding(Severity.ERROR, "units", where, text)
                break
    for figure, name in ((figures[2], "push angles"), (figures[5], "object yaws")):
        if 180.0 / math.pi / 3 < figure.ratio < 180.0 / math.pi * 3:
            text = f"the {name} look like degrees; expected radians: multiply them by pi / 180"
            yield DatasetFinding(Severity.ERROR, "units", where, text)


def odd_statistics(
    where: str, figures: Iterable[QuantityStatistics], pushes: int, kind: SurfaceKind = SurfaceKind.ABS
) -> Iterator[DatasetFinding]:
    """Find means and standard deviations far from the published ones, which are those on ABS."""
    if pushes < ENOUGH_PUSHES:
        text = f"{pushes} pushes are too few to compare their statistics with the published ones"
        yield DatasetFinding(Severity.WARNING, "statistics", where, text)
        return
    odd = STD_RATIO_ODD if kind is SurfaceKind.ABS else STD_RATIO_ODD_ELSEWHERE
    for figure in figures:
        spread = max(figure.ratio, 1.0 / figure.ratio if figure.ratio else math.inf)
        shift = abs(figure.mean - figure.published_mean) / figure.published_std
        if spread > odd or shift > MEAN_SHIFT_ODD:
            wrong = spread > STD_RATIO_WRONG or shift > MEAN_SHIFT_WRONG
            text = (
                f"{figure.quantity} has mean {figure.mean:.4g} and deviation {figure.std:.4g}; published are "
                f"{figure.published_mean:.4g} and {figure.published_std:.4g}: check units and frame"
            )
            yield DatasetFinding(Severity.ERROR if wrong else Severity.WARNING, "statistics", where, text)


def odd_quantiles(where: str, found: MotionQuantiles, other: MotionQuantiles, name: str) -> Iterator[DatasetFinding]:
    """Find quantiles of the motion that differ from those of other pushes."""
    for quantity, here, there, slack, unit in (
        ("distance", found.distance_mm, other.distance_mm, DIFFERENT_MM, "mm"),
        ("turn", found.turn_deg, other.turn_deg, DIFFERENT_DEG, "degrees"),
    ):
        apart = [
            f"{100 * level:.0f} %: {mine:.1f} instead of {theirs:.1f}"
            for level, mine, theirs in zip(QUANTILES, here, there, strict=True)
            if abs(mine - theirs) > max(slack, DIFFERENT * theirs)
        ]
        if apart:
            text = f"quantiles of the {quantity} in {unit} differ from those of {name} by over 15 %: {', '.join(apart)}"
            yield DatasetFinding(Severity.WARNING, "quantiles", where, text)


def odd_normalised(where: str, twins: Mapping[str, tuple[ObjectPushes, Array]]) -> Iterator[DatasetFinding]:
    """Find normalised twins that differ from the raw pushes under the published statistics.

    Args:
        where: The surface.
        twins: By descriptor, the raw object and its normalised twin as [pushes, 6]: pushers, outcomes.
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
            f"other pushes in the normalised twins than in the raw files of {counted(other_pushes)}; "
            "fetch both again, or remove the twins if the raw files are the right ones"
        )
        yield DatasetFinding(Severity.ERROR, "twin-differs", where, text)
    if other_statistics:
        text = (
            f"normalised twins made with other statistics than the published ones of {counted(other_statistics)}; "
            "the trainer reads the raw files"
        )
        yield DatasetFinding(Severity.WARNING, "twin-statistics", where, text)


def surface_findings(
    where: str,
    objects: Sequence[ObjectPushes],
    figures: Sequence[QuantityStatistics],
    motion: MotionQuantiles | None = None,
    kind: SurfaceKind = SurfaceKind.ABS,
) -> list[DatasetFinding]:
    """Check the pushes of one surface, and their motion beside Omnipush's recorded one, if it is of the same kind.

    Wrong units suppress the findings that only follow from them.
    """
    pushers = np.concatenate([item.pushers for item in objects])
    outcomes = np.concatenate([item.outcomes for item in objects])
    units = list(odd_units(where, figures))
    return [
        *units,
        *(
            []
            if units
            else [*odd_angles(where, pushers, outcomes), *odd_statistics(where, figures, len(pushers), kind)]
        ),
        *odd_twins(where, objects),
        *odd_contact(where, objects),
        *([] if units or motion is None else odd_quantiles(where, motion, recorded_motion(), "Omnipush's recordings")),
        *odd_rows(where, objects),
        *odd_precision(where, objects),
    ]


def _rows(objects: Iterable[ObjectPushes]) -> Iterator[tuple[ObjectPushes, npt.NDArray[np.float32]]]:
    """Return the pushers and outcomes of each object side by side, [pushes, 6], in the precision of training."""
    for item in objects:
        yield item, np.column_stack([item.pushers, item.outcomes]).astype(np.float32)


def _same_pushes_turned(first: ObjectPushes, other: ObjectPushes) -> bool:
    """Return whether the other object has the positions of the first, turned as its descriptor is."""
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
    """Return whether each column of the twin is the expected column, shifted and scaled."""
    for wanted, found in zip(expected.T, twin.T, strict=True):
        model = np.column_stack([wanted, np.ones(len(wanted))])
        solution, *_ = np.linalg.lstsq(model, found, rcond=None)
        if len(wanted) <= model.shape[1] or np.abs(model @ solution - found).max() > TWIN_TOLERANCE:
            return False
    return True
