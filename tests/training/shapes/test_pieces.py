"""Pieces of outlines: on the grid, of the stated extents, and whole."""

import math

import numpy as np
import pytest
from shapely import MultiPolygon, Polygon

from training.shapes.pieces import (
    GRID,
    capsule,
    disc,
    ellipse,
    moved,
    rectangle,
    regular,
    rounded,
    united,
    whole,
    without,
)


def test_pieces_have_their_area_and_place() -> None:
    """Area and centroid of each piece are those of its formula."""
    assert rectangle(2.0, 0.5, (1.0, 2.0)).equals(Polygon([(0, 1.75), (2, 1.75), (2, 2.25), (0, 2.25)]))
    assert disc(1.0, (3.0, 4.0)).area == pytest.approx(math.pi, rel=2e-3)
    assert disc(1.0, (3.0, 4.0)).centroid.coords[0] == pytest.approx((3.0, 4.0), abs=1e-6)
    assert ellipse(2.0, 0.5).area == pytest.approx(math.pi, rel=2e-3)
    assert regular(6).area == pytest.approx(1.5 * math.sqrt(3.0), rel=1e-5)
    assert capsule((0.0, 0.0), (1.0, 0.0), 0.2).area == pytest.approx(0.2 + math.pi * 0.01, rel=2e-3)
    assert capsule((0.0, 0.0), (1.0, 0.0), 0.2, 0.1).bounds == pytest.approx((-0.1, -0.1, 1.05, 0.1))


def test_rounding_takes_away_outer_corners_and_fills_inner_ones() -> None:
    """A square loses (4 - pi) r^2, and an L gains at its inner corner a quarter of that."""
    square, corner = rectangle(1.0, 1.0), united(rectangle(1.0, 0.4, (0.5, 0.2)), rectangle(0.4, 1.0, (0.2, 0.5)))
    lost = (4.0 - math.pi) * 0.1**2

    assert rounded(square, 0.1).area == pytest.approx(1.0 - lost, abs=5e-4)
    assert rounded(corner, 0.1).area == pytest.approx(corner.area - 5 / 4 * lost + lost / 4, abs=5e-4)


def test_a_turn_of_a_quarter_is_exact() -> None:
    """A piece that is turned by a quarter and shifted lies on the grid again."""
    assert moved(rectangle(1.0, 0.5), (1.0, 0.0), math.pi / 2).bounds == (0.75, -0.5, 1.25, 0.5)


def test_a_whole_piece_has_no_hole_and_no_islands() -> None:
    """A ring is filled, and of several parts the largest is kept."""
    ring = Polygon(rectangle(4.0, 4.0).exterior, [rectangle(1.0, 1.0).exterior])

    assert whole(MultiPolygon([ring, rectangle(1.0, 1.0, (9.0, 0.0))])).equals(rectangle(4.0, 4.0))
    assert whole(MultiPolygon()).is_empty


def test_a_bite_through_the_middle_leaves_the_larger_half() -> None:
    """Cutting a bar in two keeps one piece."""
    assert without(rectangle(4.0, 1.0), rectangle(0.5, 2.0, (1.0, 0.0))).bounds == (-2.0, -0.5, 0.75, 0.5)


def test_corners_of_unions_lie_on_the_grid() -> None:
    """Crossings of edges are rounded too."""
    corners = np.array(united(regular(5), regular(7, 1.1, 0.3)).exterior.coords) / GRID

    assert np.abs(corners - np.round(corners)).max() < 1e-4
