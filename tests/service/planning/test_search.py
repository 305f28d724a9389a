"""Search of sequences: the fewest sure pushes, with motions that are known in closed form."""

import itertools

import numpy as np
import pytest

from service.planning.candidates import Candidates
from service.planning.particles import Region
from service.planning.search import Found, Search, ends_of
from service.pushing.poses import DoubleArray

GOAL = Region((0.1, 0.0, 0.0), 0.01, 0.1)
STEP_M = 0.05


def candidates(
    *motions: tuple[float, float, float], std: tuple[float, float, float] = (1e-4, 1e-4, 1e-3)
) -> Candidates:
    """Return candidates with given motions."""
    found = np.array(motions)
    deviations = np.tile(std, (len(found), 1))
    return Candidates(np.zeros_like(found), np.zeros((len(found), 4)), found, deviations, deviations)


AHEAD = candidates((STEP_M, 0.0, 0.0), (0.0, STEP_M, 0.0), (0.0, 0.0, 0.5))


def search(
    known: Candidates,
    goal: Region = GOAL,
    most: int = 10,
    start: tuple[float, float, float] = (0.0, 0.0, 0.0),
    **given: object,
) -> Found:
    """Search from a pose, without obstacles unless a function is given."""

    def remaining_m(places: DoubleArray) -> DoubleArray:
        """Return the straight way."""
        return np.asarray(np.hypot(places[:, 0] - goal.pose[0], places[:, 1] - goal.pose[1]))

    parts = {
        "centre": np.zeros(2),
        "remaining_m": remaining_m,
        "is_free": lambda before, after, rows, is_first: np.ones(len(rows), dtype=np.bool_),
        "is_over": lambda: False,
    } | given
    return Search(known, goal, **parts).run(np.array(start), most)  # type: ignore[arg-type]


def test_a_goal_two_steps_ahead_takes_two_steps() -> None:
    """The sequence repeats the one candidate that leads ahead."""
    found = search(AHEAD)
    assert found.sequence is not None
    assert found.sequence.rows.tolist() == [0, 0]
    assert found.sequence.reached > 0.99
    assert found.is_complete


def test_turned_objects_move_where_they_look() -> None:
    """Candidates are motions in the object's own frame, so a start that looks along y goes along y."""
    goal = Region((0.0, 0.1, np.pi / 2), 0.01, 0.1)
    found = search(AHEAD, goal, start=(0.0, 0.0, np.pi / 2))
    assert found.sequence is not None
    assert found.sequence.rows.tolist() == [0, 0]


def test_turns_and_ways_are_combined() -> None:
    """Of all orders of two steps and two turns, one is found that ends in the goal."""
    goal = Region((0.1, 0.0, 1.0), 0.01, 0.05)
    found = search(AHEAD, goal)
    assert found.sequence is not None
    assert sorted(found.sequence.rows.tolist()) == [0, 0, 2, 2]
    end = ends_of(np.zeros(3), AHEAD.motions[found.sequence.rows])[-1]
    assert end == pytest.approx([0.1, 0.0, 1.0])


def test_two_sure_pushes_are_better_than_one_that_may_fail() -> None:
    """A push that reaches the goal at once, but deviates by three tolerances, is not taken."""
    sure = search(candidates((0.05, 0.0, 0.0), (0.1, 0.0, 0.0)))
    assert sure.sequence is not None
    assert len(sure.sequence.rows) == 1
    known = candidates((0.05, 0.0, 0.0), (0.1, 0.0, 0.0))
    wild = Candidates(
        known.parameters, known.pushes, known.motions, *np.array([[[1e-4, 1e-4, 1e-3], [0.03, 0.03, 0.3]]] * 2)
    )
    careful = search(wild)
    assert careful.sequence is not None
    assert careful.sequence.rows.tolist() == [0, 0]


def test_too_few_pushes_tell_how_near_they_come() -> None:
    """One push of two ends 50 mm off."""
    found = search(AHEAD, most=1)
    assert found.sequence is None
    assert list(found.nearest) == pytest.approx([0.05, 0.0])
    assert found.is_complete


def test_pushes_that_touch_something_are_not_used() -> None:
    """With a wall across the way ahead, the sequence goes around it."""

    def is_free(_: DoubleArray, after: DoubleArray, rows: DoubleArray, is_first: bool) -> DoubleArray:
        """Return true outside of a wall about the middle of the straight way."""
        return np.asarray((np.abs(after[:, 0] - 0.05) > 0.01) | (after[:, 1] > 0.04))

    ways = candidates((STEP_M, 0.0, 0.0), (0.0, STEP_M, 0.0), (0.0, -STEP_M, 0.0))
    found = search(ways, is_free=is_free)
    assert found.sequence is not None
    assert sorted(found.sequence.rows.tolist()) == [0, 0, 1, 2]
    assert found.sequence.rows[0] == 1
    assert search(ways, is_free=lambda *_: np.zeros(len(_[2]), dtype=np.bool_)).sequence is None


def test_first_pushes_are_checked_as_such() -> None:
    """A first push that is not sure enough is replaced, and allowed later."""

    def is_free(_: DoubleArray, after: DoubleArray, rows: DoubleArray, is_first: bool) -> DoubleArray:
        """Return true for all but the first candidate, if it is the first push."""
        return np.asarray((rows != 0) | (not is_first))

    found = search(candidates((0.06, 0.0, 0.0), (0.04, 0.0, 0.0)), is_free=is_free)
    assert found.sequence is not None
    assert found.sequence.rows.tolist() == [1, 0]


def test_a_search_that_is_stopped_says_so() -> None:
    """A clock that strikes after the first step leaves the nearest end so far."""
    strikes = itertools.chain([False], itertools.repeat(True))
    found = search(candidates((0.01, 0.0, 0.0)), is_over=lambda: next(strikes))
    assert not found.is_complete
    assert found.sequence is None
    assert found.nearest[0] == pytest.approx(0.08)


def test_the_centre_of_an_object_counts_for_its_way_and_its_frame_for_the_goal() -> None:
    """An outline far from its origin is brought to the goal of its frame."""
    centre = np.array([0.5, 0.0])
    turn = (0.5 - 0.5 * np.cos(0.5), -0.5 * np.sin(0.5), 0.5)  # about the centre
    found = search(candidates(turn, (0.0, 0.0, -0.5)), Region((*turn[:2], 0.5), 0.01, 0.05), centre=centre)
    assert found.sequence is not None
    assert found.sequence.rows.tolist() == [0]
