"""Push maps: starts around an outline, and measures of how much each push does."""

import math

import numpy as np
import pytest

from service.planning.push_map import GAP_M, push_map, pushes_around
from service.planning.push_model import PushOutcomes
from service.pushing.first_contact import first_contact
from service.pushing.outlines import Outline
from service.pushing.poses import DoubleArray

BOX = Outline.of([[0.06, 0.04], [-0.06, 0.04], [-0.06, -0.04], [0.06, -0.04]])
U = Outline.of([[-0.05, 0.05], [-0.05, -0.05], [0.05, -0.05], [0.05, 0.05], [0.004, 0.05], [0.004, 0.0], [-0.004, 0.0], [-0.004, 0.05]])  # fmt: skip # noqa: E501
RADIUS_M = 0.005


def test_every_push_starts_clear_of_the_outline_and_meets_it_at_once() -> None:
    """The gap along the normal is the same everywhere, and the first contact is the named point."""
    found = pushes_around(BOX, 40, [0.0], 0.05, RADIUS_M)
    assert len(found.pushes) == 40
    assert BOX.distance_m(found.pushes[:, :2]) == pytest.approx(np.full(40, RADIUS_M + GAP_M))
    met = first_contact(BOX, found.pushes, RADIUS_M)
    assert met.travel_m == pytest.approx(np.full(40, GAP_M))
    assert met.point_m == pytest.approx(found.points_m)


def test_angles_are_from_the_inward_normal() -> None:
    """From the right side of a box a push along the normal heads along -x, and a positive angle turns it left."""
    found = pushes_around(BOX, 4, [0.0, 0.3], 0.05, RADIUS_M)
    right = np.isclose(found.points_m[:, 0], 0.06)
    assert np.abs(found.pushes[right, 2]) == pytest.approx([math.pi, math.pi - 0.3])
    assert found.pushes[right, 2][1] == pytest.approx(0.3 - math.pi)


def test_a_tip_that_does_not_fit_is_left_out() -> None:
    """No start lies in a slot that is narrower than the tip, and starts elsewhere remain."""
    found = pushes_around(U, 200, [0.0], 0.05, RADIUS_M)
    x, y = found.points_m.T
    assert 100 < len(found.pushes) < 200
    assert not ((np.abs(x) < 0.0039) & (y > 0.001)).any()
    assert (U.distance_m(found.pushes[:, :2]) >= RADIUS_M - 1e-6).all()


def test_effectiveness_is_one_for_an_object_that_moves_with_the_tip() -> None:
    """It is zero for an object that stays, and counts the motion of points if it only turns about its centroid."""
    turn = 0.1

    def model(pushes: DoubleArray) -> PushOutcomes:
        """Move along, stay, and turn about the centroid."""
        x, y = BOX.centroid_m
        mean = np.array([[0.03, 0.04, 0.0], [0.0, 0.0, 0.0], [x - math.cos(turn) * x, y, turn]])
        no = np.zeros(3, dtype=np.bool_)
        return PushOutcomes(mean, np.array([[0.003, 0.004, 0.0], [0.0] * 3, [0.0, 0.0, 0.1]]), no, no, no)

    around = pushes_around(BOX, 3, [0.0], 0.05, RADIUS_M)
    found = push_map(model, BOX, around)
    assert found.effectiveness == pytest.approx([1.0, 0.0, 2.0 * math.sin(turn / 2.0) * BOX.size_m / 0.05])
    assert found.uncertainty_m == pytest.approx([0.005, 0.0, 0.1 * BOX.size_m])
