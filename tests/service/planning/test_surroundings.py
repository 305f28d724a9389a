"""Surroundings: distances from workspace and obstacles, and ways around them."""

import numpy as np
import pytest

from service.planning.surroundings import Surroundings, Wave
from tests.service.planning.boxes import square

ROOM = square(0.0, 0.0, 1.0)
WALL = square(0.2, 0.0, 0.3)
PLACES = np.array([[0.0, 0.0], [0.2, 0.0], [-0.45, 0.0], [0.7, 0.0], [0.0, 0.3]])


def test_distances_are_to_the_nearest_of_walls_and_obstacles() -> None:
    """Inside of an obstacle and outside of the workspace they are negative."""
    found = Surroundings(ROOM, (WALL,)).distance_m(PLACES)
    assert found == pytest.approx([0.05, -0.15, 0.05, -0.2, np.hypot(0.05, 0.15)])


def test_a_grid_answers_as_the_polygons_do() -> None:
    """Whatever the grid's cells are, places on both sides of a limit are told apart exactly, far away ones too."""
    rng = np.random.default_rng(0)
    places = np.concatenate([rng.uniform(-0.8, 0.8, (4000, 2)), [[0.05 - 1e-9, 0.0], [0.05 + 1e-9, 0.0], [9.0, 9.0]]])
    for around in (Surroundings(ROOM, (WALL,)), Surroundings(None, (WALL,), np.array([[0.0, 0.0], [2.0, 0.0]]))):
        for least_m in (0.0, 0.03):
            assert np.array_equal(around.keeps(places, least_m), around.distance_m(places) >= least_m)


def test_without_surroundings_every_place_is_free() -> None:
    """No workspace and no obstacle forbid nothing, however much room is asked for."""
    assert Surroundings(None, ()).is_empty
    assert Surroundings(None, ()).keeps(PLACES, 100.0).all()


def test_a_wave_goes_around_an_obstacle() -> None:
    """Behind a wall the way is longer than the straight one, and in sight it is about as long."""
    wave = Wave.around(Surroundings(ROOM, (WALL,)), np.array([0.42, 0.0]), 0.01)
    behind, beside = wave.distance_m(np.array([[-0.02, 0.0], [0.42, 0.3]]))
    assert behind > 0.44 + 0.05
    assert beside == pytest.approx(0.3, abs=0.04)


def test_a_goal_that_cannot_be_reached_is_far() -> None:
    """A wall across the whole workspace leaves no way, and the wave says more than any way is long."""
    across = tuple(square(0.0, y, 0.2) for y in (-0.4, -0.2, 0.0, 0.2, 0.4))
    wave = Wave.around(Surroundings(ROOM, across), np.array([0.3, 0.0]), 0.02)
    assert wave.distance_m(np.array([[-0.3, 0.0]]))[0] > 10.0
