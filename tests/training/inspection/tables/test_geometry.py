"""Geometry of recorded pushes, against figures that are known by hand."""

import math

import numpy as np
import pytest

from service.pushing.outlines import Outline
from tests.training.tables.tables import BOX, WEDGE, pushed_table
from training.inspection.tables.geometry import centroid_motion, push_geometry
from training.tables.push_table import PushTable, TableObject


def one_push(pusher: tuple[float, float, float, float], outcome: tuple[float, float, float]) -> PushTable:
    """Return a table of one push of a box of 100 mm by 60 mm with a tip of 5 mm."""
    zero = np.zeros(1, dtype=np.int64)
    box = TableObject("box", Outline.of(BOX))
    return PushTable(
        (box,), zero, np.array([pusher]), np.array([outcome]), np.array([0.005]), ("table",), zero, "a test", "0"
    )


def test_a_push_through_the_middle_is_measured() -> None:
    """Measure 5 mm of clearance, then contact within the tolerance, 40 mm of motion, and touch at the end."""
    found = push_geometry(one_push((-0.06, 0.0, 0.0, 0.045), (0.04, 0.0, 0.0)))

    assert found.start_m[0] == pytest.approx(0.005)
    assert found.travel_m[0] == pytest.approx(0.002)  # less 3 mm of tolerance
    assert found.end_m[0] == pytest.approx(0.0, abs=1e-12)
    assert found.motion_m[0] == pytest.approx(0.04)
    assert found.along_m[0] == pytest.approx(0.04)


def test_a_push_that_passes_by_reaches_no_outline() -> None:
    """Measure an endless travel beside the box, and motion against a push as negative."""
    found = push_geometry(one_push((-0.06, 0.05, 0.0, 0.1), (-0.01, 0.0, 0.0)))

    assert not found.reaches[0]
    assert found.moved[0]
    assert found.along_m[0] == pytest.approx(-0.01)


def test_the_centroid_moves_about_another_origin() -> None:
    """Turn a box about a corner by 90 degrees: its centroid moves although the origin stays."""
    box = Outline.of(np.array(BOX) + np.array([0.05, 0.03]))
    np.testing.assert_allclose(centroid_motion(box, np.array([[0.0, 0.0, math.pi / 2]])), [[-0.08, 0.02]], atol=1e-12)


def test_the_order_of_the_rows_does_not_matter() -> None:
    """Measure the pushes of two objects in any order."""
    table = pushed_table({"wedge": Outline.of(WEDGE), "box": Outline.of(BOX)}, 10)
    order = np.random.default_rng(0).permutation(table.count)

    np.testing.assert_array_equal(push_geometry(table.select(order)).end_m, push_geometry(table).end_m[order])
