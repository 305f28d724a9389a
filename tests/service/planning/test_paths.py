"""Paths: pushes that keep object and tip clear of obstacles all along their way."""

import numpy as np
import pytest

from service.planning.paths import Paths
from service.planning.surroundings import Surroundings
from service.pushing.outlines import Outline
from tests.service.planning.boxes import BOX, RADIUS_M, square

ROOM = square(0.0, 0.0, 1.0)
NEEDLE = Outline.of([[0.1, -0.2], [0.102, -0.2], [0.102, 0.2], [0.1, 0.2]])
STILL = np.zeros((1, 3))


def paths(*obstacles: Outline, room: Outline | None = ROOM, clearance_m: float = 0.005) -> Paths:
    """Return the paths of the box."""
    return Paths(Surroundings(room, obstacles), BOX, RADIUS_M, 0.1, clearance_m)


def is_free(found: Paths, after: tuple[float, float, float], push: tuple[float, float, float, float]) -> bool:
    """Return whether a push from the origin to a pose is free."""
    return bool(found.free(STILL, np.array([after]), np.array([push]), found.kept_m)[0])


@pytest.mark.parametrize(
    ("after", "expected"),
    [
        ((0.03, 0.0, 0.0), True),  # 10 mm before the needle
        ((0.037, 0.0, 0.0), False),  # nearer than the clearance
        ((0.3, 0.0, 0.0), False),  # from one side to the other, through it
        ((0.015, 0.0, np.pi), True),  # a turn that stays clear with its corners
        ((0.03, 0.0, np.pi), False),  # a turn whose corners come too near on the way
        ((-0.43, 0.0, 0.0), True),  # 10 mm before the edge of the workspace
        ((-0.45, 0.0, 0.0), False),  # out of it
    ],
)
def test_an_object_keeps_clear_all_along_its_way(after: tuple[float, float, float], expected: bool) -> None:
    """A needle of 2 mm between two poses is not jumped over."""
    away = (-0.3, -0.3, 0.0, 0.01)
    assert is_free(paths(NEEDLE), after, away) == expected


@pytest.mark.parametrize(
    ("push", "expected"),
    [
        ((0.09 - RADIUS_M, 0.3, np.pi / 2, 0.05), True),
        ((0.05, 0.15, 0.0, 0.1), False),  # its way crosses the needle
        ((0.094, 0.1, np.pi / 2, 0.05), False),  # its rim touches it
        ((-0.48, 0.0, np.pi, 0.05), False),  # out of the workspace
        ((-0.498, 0.0, 0.0, 0.05), False),  # it starts in the wall
    ],
)
def test_a_tip_keeps_clear_all_along_its_way(push: tuple[float, float, float, float], expected: bool) -> None:
    """The disc of the tip counts, not its middle alone."""
    assert is_free(paths(NEEDLE), (0.0, 0.0, 0.0), push) == expected


def test_gaps_are_exact_and_negative_for_overlaps() -> None:
    """A square 20 mm beside the box, one that it overlaps, and one that lies wholly inside of it."""
    assert paths(square(0.13, 0.0, 0.1)).gap_m(np.zeros(3)) == pytest.approx(0.02)
    assert paths(square(0.1, 0.0, 0.1)).gap_m(np.zeros(3)) < 0.0
    assert paths(square(0.0, 0.0, 0.01)).gap_m(np.zeros(3)) < 0.0
    assert paths(room=None).gap_m(np.zeros(3)) == np.inf


def test_an_object_with_a_long_outline_keeps_as_far_as_its_samples_are_apart() -> None:
    """So that nothing fits between two samples, whatever clearance was asked for."""
    side = np.linspace(-0.9, 0.9, 200)
    comb = np.concatenate([np.stack([side, 0.2 * (np.arange(200) % 2)], axis=1), [[0.9, -0.1], [-0.9, -0.1]]])
    found = Paths(Surroundings(ROOM, ()), Outline.of(comb), RADIUS_M, 0.1, 0.002)
    assert found.kept_m > 0.1
    assert paths(clearance_m=0.004).kept_m == 0.004


def test_no_pushes_and_no_surroundings_are_free() -> None:
    """Without rows there are no answers, and without surroundings all are true."""
    none = np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 4))
    assert paths().free(*none, 0.0).shape == (0,)
    assert paths(room=None).free(STILL, STILL + 9.0, np.zeros((1, 4)), 0.1).tolist() == [True]


def test_what_is_not_known_of_a_push_is_kept_at_its_end() -> None:
    """The object keeps a spread more where the push ends, half of it in the middle, and none at its start."""
    found, push = paths(NEEDLE), np.array([[-0.3, -0.3, 0.0, 0.01]])
    near, far = np.array([[0.03, 0.0, 0.0]]), np.array([[-0.1, 0.0, 0.0]])  # 10 mm before the needle, and away from it
    for spread_m, expected in ((0.0, True), (0.004, True), (0.006, False)):
        assert found.free(STILL, near, push, 0.005, spread_m).tolist() == [expected]
    assert found.free(near, far, push, 0.005, 0.1).tolist() == [True]
    two = found.free(np.repeat(STILL, 2, 0), np.repeat(near, 2, 0), np.repeat(push, 2, 0), 0.005, np.array([0.0, 0.1]))
    assert two.tolist() == [True, False]


def test_the_frame_of_an_outline_does_not_matter() -> None:
    """A box whose frame is 3 m away from it turns about itself, and not through the needle."""
    away = np.array([3.0, 0.0])
    far = Paths(Surroundings(ROOM, (NEEDLE,)), Outline.of(BOX.corners + away), RADIUS_M, 0.1, 0.005)
    before, after = np.array([[-3.0, 0.0, 0.0]]), np.array([[3.0, 0.0, np.pi]])  # half a turn in its place
    push = np.array([[-0.3, -0.3, 0.0, 0.01]])
    assert far.gap_m(before[0]) == pytest.approx(0.04)
    assert far.free(before, after, push, 0.005).tolist() == [True]
    assert far.free(before, after + np.array([0.03, 0.0, 0.0]), push, 0.005).tolist() == [False]


def test_paths_that_are_not_checked_in_time_are_not_free() -> None:
    """Away from everything no check is needed, and beside a needle a late one is none."""
    late = Paths(Surroundings(None, (NEEDLE,)), BOX, RADIUS_M, 0.1, 0.005, is_over=lambda: True)
    push, near = np.array([[-0.3, -0.3, 0.0, 0.01]]), np.array([[0.03, 0.0, 0.0]])
    assert late.free(STILL, STILL, push, 0.005).tolist() == [True]
    assert late.free(near, near, push, 0.005).tolist() == [False]
    assert paths(NEEDLE).free(near, near, push, 0.005).tolist() == [True]


@pytest.mark.parametrize(
    "obstacle",
    [
        [[0.043, 0.051], [0.017, 0.051], [0.017, 0.025], [0.043, 0.025]],  # a corner of it is inside of the box
        [[0.0, -0.2], [0.001, -0.2], [0.001, 0.2], [0.0, 0.2]],  # crosses it, with every corner outside
        [[-0.01, -0.01], [0.01, -0.01], [0.0, 0.01]],  # inside
        [[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]],  # around it
    ],
)
@pytest.mark.parametrize("clearance_m", [0.001, 0.1])
def test_an_object_that_overlaps_an_obstacle_has_no_gap(obstacle: list[list[float]], clearance_m: float) -> None:
    """However they overlap, and whatever the clearance, no sample has to lie in both."""
    found = paths(Outline.of(obstacle), room=None, clearance_m=clearance_m)
    assert found.gap_m(np.zeros(3)) == -np.inf
    assert found.gap_m(np.array([2.0, 0.0, 0.3])) > 0.7


def test_a_gap_is_that_of_the_nearest_corner() -> None:
    """The corner of an obstacle may be nearer to an edge of the object than any corner of the object to it."""
    spike = Outline.of([[0.013, 0.0437], [0.1, 0.3], [-0.1, 0.3]])
    assert paths(spike, room=None, clearance_m=0.05).gap_m(np.zeros(3)) == pytest.approx(0.0037)


def test_a_large_clearance_does_not_spread_samples() -> None:
    """Posts between coarse samples would go unnoticed where no clearance is asked for, as in counting collisions."""
    assert paths(NEEDLE, clearance_m=0.2).spacing_m <= 0.005
    assert paths(NEEDLE, clearance_m=0.2).kept_m == 0.2
