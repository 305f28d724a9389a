"""Tests of the points on which objects rest."""

import numpy as np
import pytest

from service.pushing.outlines import Outline
from service.pushing.support import LEAST_POINTS, MOST_POINTS, MOST_PRESSURE, balanced, even_points, support

BOX = Outline.of([(0.0, 0.0), (0.09, 0.0), (0.09, 0.04), (0.0, 0.04)])


def test_points_spread_as_the_area_does() -> None:
    """The mean square distance of the points of a box from its centroid is that of its area, within 15 percent."""
    points = even_points(BOX)
    assert LEAST_POINTS <= len(points) <= MOST_POINTS
    spread = np.sqrt(((points - BOX.centroid_m) ** 2).sum(axis=1).mean())
    assert spread == pytest.approx(BOX.size_m, rel=0.15)


def test_shares_balance_at_the_centre_of_mass() -> None:
    """The shares are positive, sum to one, and their mean is the centre of mass."""
    centre = BOX.centroid_m + np.array([0.01, -0.005])
    points, shares = support(BOX, centre)
    assert shares.min() > 0.0
    assert shares.sum() == pytest.approx(1.0)
    assert shares @ points == pytest.approx(centre, abs=1e-9)


def test_a_centre_of_mass_that_no_point_surrounds_has_equal_shares() -> None:
    """An object that would tip over is taken to press evenly."""
    points, shares = support(BOX, np.array([0.2, 0.02]))
    assert shares == pytest.approx(np.full(len(points), 1.0 / len(points)))


def test_balanced_shares_are_the_spread_itself_if_that_balances() -> None:
    """Four points around their middle keep equal shares, and two that cannot balance a third place give none."""
    square = np.array([(1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0)])
    assert balanced(square, np.full(4, 0.25), np.zeros(2), 1.0) == pytest.approx(np.full(4, 0.25))
    assert balanced(square[:2], np.full(2, 0.5), np.zeros(2), 1.0) is None


def test_a_sliver_rests_on_its_corners_without_a_huge_grid() -> None:
    """An outline that fills almost none of its box takes bounded work."""
    sliver = Outline.of([(0.0, 0.0), (1.0, 1.0), (1.0, 1.0 + 1e-5)])
    points, shares = support(sliver, sliver.centroid_m)
    assert len(points) == 3
    assert shares == pytest.approx(np.full(3, 1.0 / 3.0), abs=0.01)


def test_a_sliver_of_many_corners_rests_on_some_of_them() -> None:
    """No outline has more points than the tensor holds."""
    along = np.linspace(0.0, 1.0, 256)
    upper, lower = np.column_stack([along, along + 1e-5]), np.column_stack([along, along])
    points, shares = support(Outline.of(np.concatenate([lower, upper[::-1]])), np.array([0.5, 0.5]))
    assert LEAST_POINTS <= len(points) <= MOST_POINTS
    assert shares.sum() == pytest.approx(1.0)


def test_pressure_at_the_rim_lies_further_out_and_still_balances() -> None:
    """Weight that a pressure moves outward has a larger mean square distance, about the same centre of mass."""
    centre = BOX.centroid_m + np.array([0.005, 0.002])
    spreads = []
    for alike in (-1.0, 0.0, 1.0):
        points, shares = support(BOX, centre, (alike, 0.0, alike))
        assert shares @ points == pytest.approx(centre, abs=1e-9)
        spreads.append(shares @ ((points - centre) ** 2).sum(axis=1))
    assert spreads[0] < 0.9 * spreads[1] < spreads[1] < 0.9 * spreads[2]


def test_pressure_may_lie_along_one_direction() -> None:
    """Weight moves to both ends along x with xx, and to two opposite corners with xy."""
    points, along = support(BOX, BOX.centroid_m, (1.0, 0.0, 0.0))
    _, even = support(BOX, BOX.centroid_m)
    _, aslant = support(BOX, BOX.centroid_m, (0.0, 1.0, 0.0))
    x, y = (points - BOX.centroid_m).T
    assert along @ x**2 > 1.1 * (even @ x**2)
    assert aslant @ (x * y) > 1e-5 > abs(even @ (x * y))


def test_the_largest_pressures_are_finite() -> None:
    """Pressures at their limits leave positive shares that sum to one."""
    for sign in (-1.0, 1.0):
        _, shares = support(BOX, BOX.centroid_m, (sign * MOST_PRESSURE, MOST_PRESSURE, sign * MOST_PRESSURE))
        assert shares.min() >= 0.0
        assert shares.sum() == pytest.approx(1.0)
