"""Tracing: boundaries of regions beside shapely's areas, and their simplification."""

import numpy as np
import pytest
import shapely

from service.silhouettes.tracing import regions, simplified


def disc(radius: float, side: int = 80) -> np.ndarray:
    """Draw the share of each pixel that a disc in the middle covers."""
    y, x = np.mgrid[:side, :side] + 0.5
    distance = np.hypot(x - side / 2.0, y - side / 2.0)
    return np.asarray(np.clip(radius + 0.5 - distance, 0.0, 1.0), dtype=np.float32)


def test_a_disc_is_traced_to_a_hundredth_of_a_pixel_square() -> None:
    """Area and place of a smoothed disc are right below the pixel, and its area is that of shapely."""
    (region,) = regions(disc(20.0))
    polygon = shapely.Polygon(region.boundary)
    assert region.area == pytest.approx(np.pi * 20.0**2, rel=0.005)
    assert polygon.area == pytest.approx(region.area, rel=1e-6)
    assert region.boundary.mean(axis=0) == pytest.approx([40.0, 40.0], abs=0.05)
    assert polygon.is_valid


def test_regions_come_largest_first_without_their_holes() -> None:
    """A ring counts with its hole filled, an island in the hole is a region of its own, and at most two are asked."""
    plane = disc(30.0) - disc(20.0) + disc(5.0)
    plane[2:6, 2:6] = 1.0
    found = regions(plane, 2)
    assert [round(one.area) for one in found] == pytest.approx([np.pi * 900.0, np.pi * 25.0], rel=0.03)
    assert len(regions(plane)) == 3


def test_a_region_at_the_border_ends_there() -> None:
    """A half plane is traced up to the border of the plane, and a full plane is the whole."""
    plane = np.zeros((10, 20), dtype=np.float32)
    plane[:, :8] = 1.0
    (region,) = regions(plane)
    assert region.boundary.min(axis=0) == pytest.approx([0.0, 0.0], abs=0.01)
    assert region.boundary.max(axis=0) == pytest.approx([8.0, 10.0], abs=0.01)
    (whole,) = regions(np.ones((3, 4), dtype=np.float32))
    assert whole.area == pytest.approx(12.0, rel=0.1)


@pytest.mark.parametrize("plane", [np.zeros((5, 5)), np.full((5, 5), 0.49), np.zeros((1, 1))])
def test_a_plane_below_the_level_has_no_region(plane: np.ndarray) -> None:
    """Nothing above one half is nothing to trace."""
    assert regions(plane.astype(np.float32)) == []


def test_a_simplified_box_has_four_corners() -> None:
    """Steps along an edge are dropped, and the corners stay where they are."""
    side = np.linspace(0.0, 1.0, 40, endpoint=False)
    corners = np.array([[0.0, 0.0], [30.0, 0.0], [30.0, 10.0], [0.0, 10.0]])
    boundary = np.concatenate(
        [a + side[:, None] * (b - a) for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)]
    )
    kept = simplified(np.roll(boundary, 17, axis=0), 100, 0.3)
    assert {tuple(corner) for corner in kept.round(6).tolist()} == {tuple(corner) for corner in corners.tolist()}


@pytest.mark.parametrize("most", [3, 8, 512])
def test_a_simplified_circle_keeps_the_tolerance_or_the_most_corners(most: int) -> None:
    """No point is farther from the polygon than the tolerance, unless that takes more corners than allowed."""
    angle = np.linspace(0.0, 2.0 * np.pi, 2000, endpoint=False)
    circle = 50.0 * np.column_stack([np.cos(angle), np.sin(angle)])
    kept = simplified(circle, most, 0.35)
    assert 3 <= len(kept) <= most
    if most == 512:
        ring = shapely.LinearRing(kept)
        assert len(kept) < 60
        assert max(ring.distance(shapely.Point(point)) for point in circle[::7]) <= 0.351


def test_equal_points_are_simplified_without_end_or_error() -> None:
    """A boundary of one repeated point ends, with few corners."""
    assert len(simplified(np.zeros((50, 2)), 512, 0.35)) <= 3
