"""Starts and aims over the whole approach to an outline, against plain geometry."""

import math
from typing import Any

import numpy as np
import pytest

from service.pushing.outlines import Outline
from training.simulation.approach import LEAST_GAP_M, Approach, draw_pushers, travel_to_touch_m
from training.simulation.exact import directions

RADIUS_M = 0.005
SQUARE = Outline.of([(-0.02, -0.02), (0.02, -0.02), (0.02, 0.02), (-0.02, 0.02)])
HORSESHOE = Outline.of([(-0.05, -0.05), (0.05, -0.05), (0.05, 0.05), (0.03, 0.05), (0.03, -0.03), (-0.03, -0.03),
                        (-0.03, 0.05), (-0.05, 0.05)])  # fmt: skip
AWAY = Outline.of([(1.00, 2.00), (1.03, 2.01), (1.01, 2.08)])  # far from the origin of its frame


def travel(outline: Outline, x_m: float, y_m: float, angle_rad: float) -> float:
    """Return the travel of one tip of 5 mm radius."""
    return float(travel_to_touch_m(outline, np.array([(x_m, y_m)]), directions(np.array([angle_rad])), RADIUS_M)[0])


def test_a_tip_travels_to_the_edge_less_its_radius() -> None:
    """Straight at an edge, the travel is the distance of the edge less the radius."""
    assert travel(SQUARE, -0.1, 0.01, 0.0) == pytest.approx(0.1 - 0.02 - RADIUS_M)


def test_a_tip_meets_a_corner_on_its_side() -> None:
    """A line 3 mm beside the square meets its corner where the circle of 5 mm does: 4 mm before it."""
    assert travel(SQUARE, -0.1, 0.023, 0.0) == pytest.approx(0.08 - 0.004)


@pytest.mark.parametrize(
    ("x_m", "y_m", "angle_rad"),
    [(-0.1, 0.0251, 0.0), (-0.1, 0.0, math.pi), (0.0, -0.1, 0.0)],
    ids=["past a corner", "away", "along"],
)
def test_a_tip_that_passes_never_touches(x_m: float, y_m: float, angle_rad: float) -> None:
    """Beside, away and along: the travel is infinite."""
    assert travel(SQUARE, x_m, y_m, angle_rad) == math.inf


def test_a_tip_inside_a_horseshoe_meets_its_inner_wall() -> None:
    """A start between the arms travels to the bottom, not through an arm."""
    assert travel(HORSESHOE, 0.0, 0.0, -math.pi / 2) == pytest.approx(0.03 - RADIUS_M)
    assert travel(HORSESHOE, 0.0, 0.0, math.pi / 2) == math.inf


@pytest.mark.parametrize("outline", [SQUARE, HORSESHOE, AWAY], ids=["square", "horseshoe", "away from the origin"])
@pytest.mark.parametrize("length_m", [0.005, 0.05, 0.12])
def test_the_share_that_misses_is_met_to_the_push(outline: Outline, length_m: float) -> None:
    """A quarter of 200 pushes never touch, the others start clear and touch within their length."""
    pushers = draw_pushers(
        outline, np.full(200, length_m), RADIUS_M, np.random.default_rng(1), Approach(miss_share=0.25)
    )
    reached = travel_to_touch_m(outline, pushers[:, :2], directions(pushers[:, 2]), RADIUS_M)

    assert np.isfinite(pushers).all()
    assert (reached > length_m).sum() == 50
    assert (outline.distance_m(pushers[:, :2]) > RADIUS_M).all()
    assert (pushers[:, 3] == length_m).all()


def test_every_push_has_its_own_length() -> None:
    """Gaps are shares of each push's own length, down to the least gap."""
    lengths_m = np.linspace(0.005, 0.12, 500)
    pushers = draw_pushers(SQUARE, lengths_m, RADIUS_M, np.random.default_rng(2), Approach(miss_share=0.0))
    gaps = travel_to_touch_m(SQUARE, pushers[:, :2], directions(pushers[:, 2]), RADIUS_M)

    assert (gaps > LEAST_GAP_M - 1e-9).all()
    assert (gaps <= lengths_m).all()
    assert np.mean(gaps / lengths_m) == pytest.approx(0.5, abs=0.05)


def test_gaps_of_higher_shapes_are_seldom_at_the_ends() -> None:
    """Shapes of 3 leave few pushes that start in touch, or that hardly reach the object."""
    settings = Approach(0.0, gap_shapes=(3.0, 3.0))
    pushers = draw_pushers(SQUARE, np.full(500, 0.05), RADIUS_M, np.random.default_rng(5), settings)
    gaps = travel_to_touch_m(SQUARE, pushers[:, :2], directions(pushers[:, 2]), RADIUS_M)

    assert np.mean((gaps < 0.005) | (gaps > 0.045)) < 0.04


def test_lines_cover_the_whole_width_unless_they_are_central() -> None:
    """Distances of the lines from the centroid are even up to the edge and the tip, or within the central band."""
    lengths_m, offsets = np.full(2000, 0.05), {}
    for share in (0.0, 1.0):
        pushers = draw_pushers(SQUARE, lengths_m, RADIUS_M, np.random.default_rng(3), Approach(0.0, share, 0.5))
        x, y, angle, _ = pushers.T
        offsets[share] = np.abs(x * np.sin(angle) - y * np.cos(angle))

    assert offsets[0.0].max() > 0.03  # the half diagonal is 28 mm, the tip 5 mm
    assert np.median(offsets[0.0]) == pytest.approx(0.015, abs=0.001)
    assert offsets[1.0].max() <= 0.5 * SQUARE.size_m


def test_the_same_seed_draws_the_same_bytes() -> None:
    """Pushes depend on the generator alone."""
    first, second = (draw_pushers(AWAY, np.full(50, 0.05), RADIUS_M, np.random.default_rng(4)) for _ in range(2))

    assert first.tobytes() == second.tobytes()


@pytest.mark.parametrize(
    "settings",
    [
        {"miss_share": 1.0},
        {"miss_share": -0.1},
        {"central_share": 1.5},
        {"central_half_width": 0.0},
        {"gap_shapes": (1.0, 0.5)},
    ],
)
def test_shares_that_are_none_are_refused(settings: dict[str, Any]) -> None:
    """A share outside of 0 to 1, or nothing but misses, is an error that shows the settings."""
    with pytest.raises(ValueError, match="shares are 0 to 1"):
        Approach(**settings)
