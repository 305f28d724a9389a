"""Measures of predicted pushes: errors, likelihood, coverage of intervals and regions, and scatter of repeated pushes.

Errors are those of the object's pose in the frame of the table: the distance in mm, and the absolute turn in degrees.
RMSE and NLL are in units of the published output deviations of Omnipush, as in every table of this project. Intervals
are central ones of one coordinate. A region is the ellipsoid of the three coordinates at once, which holds an outcome
if its squared Mahalanobis distance is below the quantile of chi-square with 3 degrees of freedom.
"""

import math
from dataclasses import dataclass
from statistics import NormalDist
from typing import Final

import numpy as np

from service.pushing.poses import DoubleArray, wrap_angles
from training.omnipush.published import published_normalisation
from training.tables.push_table import IndexArray, PushTable

LEVELS: Final = (0.50, 0.90, 0.95)
REGION_LIMITS: Final = (2.3659739, 6.2513886, 7.8147279)  # quantiles of chi-square, 3 degrees of freedom, at the levels
RESAMPLES: Final = 1000
SAME_START_M: Final = 0.001  # pushes whose starts and lengths differ by less, and directions by less than this
SAME_START_RAD: Final = math.radians(1.0)
MOST_REPEATS_ROWS: Final = 4000  # rows of an object among which repeats are looked for
_NORMAL_ROWS: Final = 5000  # from here on, the mean's interval is the normal one
_CHUNK: Final = 1 << 20  # numbers at a time


@dataclass(frozen=True)
class Mean:
    """Mean and median of errors, and the 95 % interval of the mean, if the pushes had been others of the same kind."""

    mean: float
    median: float
    low: float
    high: float


@dataclass(frozen=True)
class Calibration:
    """Honesty of predicted spreads: NLL per push, and shares of outcomes within intervals and regions, by level."""

    nll: float
    intervals: tuple[float, ...]
    regions: tuple[float, ...]


@dataclass(frozen=True)
class Score:
    """Measures of one model on some pushes. A model without spread has no calibration."""

    pushes: int
    position_mm: Mean
    yaw_deg: Mean
    rmse: float
    calibration: Calibration | None


@dataclass(frozen=True)
class Repeats:
    """Distances between the outcomes of pushes of one object from the same start."""

    pairs: int
    position_mm: Mean
    yaw_deg: Mean


def score(outcomes: DoubleArray, mean: DoubleArray, covariance: DoubleArray | None) -> Score:
    """Measure predictions, means (n, 3) and covariances (n, 3, 3), against outcomes (n, 3)."""
    error = difference(outcomes, mean)
    calibration = None if covariance is None else _calibration(error, covariance)
    rmse = math.sqrt(float(np.mean((error / published_normalisation().output_std) ** 2)))
    return Score(len(error), *_means(error), rmse, calibration)


def difference(outcomes: DoubleArray, others: DoubleArray) -> DoubleArray:
    """Return the differences (n, 3) of poses, with the turn in (-pi, pi]."""
    found = outcomes - others
    found[:, 2] = wrap_angles(found[:, 2])
    return found


def repeats(table: PushTable) -> tuple[Repeats | None, Repeats | None]:
    """Compare the pushes from the same start with each other: on the same surface, and on different ones.

    Of an object with more than 4,000 pushes, the first 4,000 are compared.
    """
    pairs = [_same_starts(table, np.flatnonzero(table.object_index == item)) for item in range(len(table.objects))]
    first, second = (np.concatenate([found[place] for found in pairs]) for place in (0, 1))
    same = table.surface_index[first] == table.surface_index[second]
    apart = difference(table.outcomes[first], table.outcomes[second])
    on_one, on_two = (Repeats(len(rows), *_means(rows)) if len(rows) else None for rows in (apart[same], apart[~same]))
    return on_one, on_two


def mean_of(values: DoubleArray) -> Mean:
    """Return the mean of errors (n,) with its 95 % interval: bootstrap of 1,000 resamples, normal from 5,000 values."""
    mean, count = float(values.mean()), len(values)
    if count > _NORMAL_ROWS:
        low, high = mean + np.array([-1.0, 1.0]) * NormalDist().inv_cdf(0.975) * values.std() / math.sqrt(count)
    else:
        rng = np.random.default_rng(0)
        rows = max(1, _CHUNK // count)
        means = [
            values[rng.integers(0, count, (min(rows, RESAMPLES - done), count))].mean(axis=1)
            for done in range(0, RESAMPLES, rows)
        ]
        low, high = np.quantile(np.concatenate(means), (0.025, 0.975))
    return Mean(mean, float(np.median(values)), float(low), float(high))


def _means(error: DoubleArray) -> tuple[Mean, Mean]:
    """Return the distances in mm and the absolute turns in degrees of differences (n, 3)."""
    return mean_of(1e3 * np.hypot(error[:, 0], error[:, 1])), mean_of(np.degrees(np.abs(error[:, 2])))


def _calibration(error: DoubleArray, covariance: DoubleArray) -> Calibration:
    std = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    z = np.abs(error / std)
    square = np.einsum("ni,ni->n", error, np.linalg.solve(covariance, error[..., None])[..., 0])
    log_det = np.linalg.slogdet(covariance)[1] - 2.0 * np.log(published_normalisation().output_std).sum()
    nll = float(np.mean(0.5 * (square + log_det + 3.0 * math.log(2.0 * math.pi))))
    half_widths = (NormalDist().inv_cdf(0.5 + level / 2.0) for level in LEVELS)
    return Calibration(
        nll,
        tuple(float(np.mean(z <= half_width)) for half_width in half_widths),
        tuple(float(np.mean(square <= limit)) for limit in REGION_LIMITS),
    )


def _same_starts(table: PushTable, rows: IndexArray) -> tuple[IndexArray, IndexArray]:
    """Return the pairs of an object's pushes, as rows of the table, that start and aim the same."""
    rows = rows[:MOST_REPEATS_ROWS]
    pushers = table.pushers[rows]
    part = max(1, _CHUNK // max(1, len(rows)))
    first, second = [np.zeros(0, dtype=np.int64)], [np.zeros(0, dtype=np.int64)]
    for start in range(0, len(rows), part):
        apart = np.abs(pushers[start : start + part, None, :] - pushers[None, :, :])
        near = np.hypot(apart[..., 0], apart[..., 1]) <= SAME_START_M
        near &= (apart[..., 3] <= SAME_START_M) & (np.abs(wrap_angles(apart[..., 2])) <= SAME_START_RAD)
        one, other = np.nonzero(np.triu(near, start + 1))
        first.append(rows[one + start])
        second.append(rows[other])
    return np.concatenate(first), np.concatenate(second)
