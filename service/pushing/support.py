"""Support: the points on which an object rests, and the share of its weight on each.

Pressure is approximated by an even grid of points under the outline. Shares balance at the centre of mass: of all that
do, those with the least relative entropy to a given spread. Only products, sums, roots and ``math.exp`` are used, so
that every processor computes the same bytes.

A **pressure** (xx, xy, yy) says how weight is spread: per area it goes with exp(xx x^2 + 2 xy x y + yy y^2), where x
and y are measured from the centroid in sizes of the object. (0, 0, 0) is even. (1, 0, 1) bears more at the rim, as on a
hard plate, and (-1, 0, -1) more in the middle. (1, 0, 0) bears more at both ends along x.
"""

import math
from typing import Final

import numpy as np

from service.pushing.outlines import Outline
from service.pushing.poses import DoubleArray

LEAST_POINTS: Final = 19  # in the grid under an outline
MOST_POINTS: Final = 2 * LEAST_POINTS - 1
MOST_PRESSURE: Final = 5.0  # of each number: at two sizes from the centroid, e^20 of the pressure there
MOST_CELLS: Final = 4096  # of the grid. An outline that fills less of its box is a sliver, which rests on its rim
_TRIES: Final = 40
_FLAT: Final = 1e-12  # determinant of the second moments, in sizes to the fourth power
_RIDGE: Final = 1e-9
_BALANCED: Final = 1e-9  # of the size
Pressure = tuple[float, float, float]
"""Spread of the weight over the underside: xx, xy, yy."""
EVEN_PRESSURE: Final[Pressure] = (0.0, 0.0, 0.0)


def support(
    outline: Outline, centre_of_mass_m: DoubleArray, pressure: Pressure = EVEN_PRESSURE
) -> tuple[DoubleArray, DoubleArray]:
    """Return points (k, 2) m of an even grid under an outline, and the shares (k,) of the weight on them.

    If the points do not surround the centre of mass, (2,) m, no shares balance there, and they spread as the pressure.
    """
    points = even_points(outline)
    spread = np.full(len(points), 1.0 / len(points))
    if pressure != EVEN_PRESSURE:
        xx, xy, yy = pressure_terms(points, outline).T
        powers = pressure[0] * xx + pressure[1] * xy + pressure[2] * yy
        spread = _exp(powers - powers.max())
        spread /= spread.sum()
    shares = balanced(points, spread, centre_of_mass_m, outline.size_m)
    return points, spread if shares is None else shares


def pressure_terms(points_m: DoubleArray, outline: Outline) -> DoubleArray:
    """Return the factors (k, 3) of xx, xy and yy of a pressure at points (k, 2) m under an outline."""
    x, y = ((points_m - outline.centroid_m) / outline.size_m).T
    return np.stack([x * x, 2.0 * x * y, y * y], axis=1)


def even_points(outline: Outline) -> DoubleArray:
    """Return the points of an even grid under an outline, (k, 2) m, at most ``MOST_POINTS``.

    There are at least ``LEAST_POINTS``, or under a sliver as many as it has corners.
    """
    spacing_m = math.sqrt(outline.area_m2 / LEAST_POINTS)
    extent = np.ptp(outline.corners, axis=0)
    points = np.empty((0, 2))
    while len(points) < LEAST_POINTS:
        if np.ceil(extent / spacing_m).prod() > MOST_CELLS:
            points = outline.corners
            break
        points = outline.samples(spacing_m)
        spacing_m *= 0.9
    return points[:: len(points) // LEAST_POINTS][:MOST_POINTS] if len(points) > MOST_POINTS else points


def balanced(points_m: DoubleArray, spread: DoubleArray, centre_m: DoubleArray, size_m: float) -> DoubleArray | None:
    """Return shares (k,) close to a spread (k,) that balance at a centre, or None if the points do not surround it.

    Of all shares that balance, these have the least relative entropy to the spread: the spread times the exponential of
    a linear function, found by Newton's method.
    """
    arm = (points_m - centre_m) / size_m
    tilt = np.zeros(2)
    for _ in range(_TRIES):
        shares = spread * _exp(arm[:, 0] * tilt[0] + arm[:, 1] * tilt[1])
        shares /= shares.sum()
        x, y = (shares * arm[:, 0]).sum(), (shares * arm[:, 1]).sum()
        if abs(x) + abs(y) < _BALANCED:
            return np.asarray(shares)
        xx = (shares * arm[:, 0] ** 2).sum() - x * x
        yy = (shares * arm[:, 1] ** 2).sum() - y * y
        xy = (shares * arm[:, 0] * arm[:, 1]).sum() - x * y
        if not xx * yy - xy * xy > _FLAT:  # points in one line
            xx, yy = xx + _RIDGE, yy + _RIDGE
        determinant = xx * yy - xy * xy
        step = np.array([(yy * x - xy * y) / determinant, (xx * y - xy * x) / determinant])
        tilt = tilt - step * min(1.0, 2.0 / max(abs(step[0]), abs(step[1]), 1e-300))
        if max(abs(tilt[0]), abs(tilt[1])) > 50.0:
            return None
    return None


def _exp(powers: DoubleArray) -> DoubleArray:
    return np.fromiter(map(math.exp, powers.tolist()), dtype=np.float64, count=len(powers))
