"""Plans: a box is brought to its goal, around obstacles, or the reason is given."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

from service.errors import DeadlineError
from service.planning.particles import Region, moved
from service.planning.paths import Paths
from service.planning.plan import Plan, PlanTask, Reason, plan
from service.planning.push_model import PushOutcomes
from service.planning.surroundings import Surroundings
from service.pushing import mechanics
from service.pushing.poses import DoubleArray, into_object_frame
from service.turns import TURN
from tests.late_turn import LateTurn
from tests.service.planning.boxes import BOX, RADIUS_M, Mechanics, square

ROOM = square(0.0, 0.0, 1.0)
TASK = PlanTask(
    np.array([-0.1, 0.0, 0.0]), Region((0.1, 0.05, 0.4), 0.01, 0.17), np.array([0.02, 0.05, 0.1]), 10,
    Surroundings(None, ()), time_s=0.1,
)  # fmt: skip


def planned(task: PlanTask, model: Mechanics | None = None) -> Plan:
    """Plan for the box, with a clock that never strikes."""
    return plan(model or Mechanics(), BOX, RADIUS_M, task, lambda: 0.0)


def pushed(pose: DoubleArray, push: DoubleArray) -> DoubleArray:
    """Return the pose of the box after a push in the world, by mechanics."""
    pusher = np.append(into_object_frame(push[None, :3], pose[None])[0], push[3])
    return moved(pose, mechanics.push(BOX, pusher[None], RADIUS_M, steps=8)[0])


def test_a_plan_brings_the_box_to_its_goal() -> None:
    """Without deviations the pushes end in the goal, and the steps are the expected poses."""
    found = planned(TASK)
    assert found.reason is None
    pose = TASK.start
    for push in found.pushes:
        pose = pushed(pose, push)
    assert TASK.goal.probability(pose[None]) == 1.0
    assert found.outcome is not None
    assert found.outcome.particles.shape[:2] == (1, len(found.pushes))
    assert 0.0 < found.goal_probability <= 1.0
    assert found.replanned_probability > 0.8
    assert found.collision_probability.tolist() == [0.0] * len(found.pushes)
    assert set(found.pushes[:, 3].tolist()) <= {0.02, 0.05, 0.1}


def test_a_seed_and_a_budget_give_the_same_plan() -> None:
    """Pushes repeat. Another seed changes the probabilities alone."""
    first, again, other = planned(TASK), planned(TASK), planned(replace(TASK, seed=1))
    assert np.array_equal(first.pushes, again.pushes)
    assert first.goal_probability == again.goal_probability
    assert np.array_equal(first.pushes, other.pushes)
    assert first.outcome is not None
    assert other.outcome is not None
    assert not np.array_equal(first.outcome.particles, other.outcome.particles)


def test_the_world_may_be_far_away() -> None:
    """Start and goal that are moved together give the same pushes, moved."""
    away = np.array([300.0, -200.0, 0.0])
    goal = Region((300.1, -199.95, 0.4), 0.01, 0.17)
    near, far = planned(TASK), planned(replace(TASK, start=TASK.start + away, goal=goal))
    assert near.pushes[:, :3] + away == pytest.approx(far.pushes[:, :3], abs=1e-6)


def test_neither_object_nor_tip_touches_an_obstacle() -> None:
    """With a block on the straight way, the expected poses and all tips keep their clearance."""
    task = replace(TASK, goal=Region((0.2, 0.0, 0.0), 0.01, 0.17), surroundings=Surroundings(ROOM, (square(0.05, 0.0, 0.06),)), most_pushes=12)  # fmt: skip # noqa: E501
    found = planned(task)
    assert found.reason is None, found.detail
    paths = Paths(task.surroundings, BOX, RADIUS_M, 0.1, task.clearance_m)
    pose = task.start
    for push in found.pushes:
        after = pushed(pose, push)
        assert paths.free(pose[None], after[None], push[None], 0.9 * task.clearance_m).tolist() == [True]
        pose = after
    assert (np.diff(found.collision_probability) >= 0.0).all()


def test_a_first_push_keeps_away_as_far_as_it_is_not_known(monkeypatch: pytest.MonkeyPatch) -> None:
    """Into a gap between two blocks a bold planner pushes at once, and ours by a sure first push."""

    class Vague(Mechanics):
        """Model whose pushes turn by 0.15 rad more or less."""

        def __call__(self, pushes: DoubleArray) -> PushOutcomes:
            """Predict pushes (n, 4)."""
            found = super().__call__(pushes)
            return replace(found, std=np.tile((0.003, 0.003, 0.15), (len(pushes), 1)))

    gap = Surroundings(None, (square(0.05, 0.1, 0.08), square(0.05, -0.1, 0.08)))
    task = replace(TASK, goal=Region((0.0, 0.0, 0.0), 0.02, 0.5), surroundings=gap)
    assert planned(task, Vague()).collision_probability[0] < 0.05
    monkeypatch.setattr("service.planning.plan.SPREADS", 0.0)
    assert planned(task, Vague()).collision_probability[0] > 0.1


def test_at_the_goal_no_push_is_needed() -> None:
    """The plan is empty, sure, and without a reason."""
    found = planned(replace(TASK, goal=Region((-0.1, 0.005, 0.0), 0.01, 0.17)))
    assert (len(found.pushes), found.goal_probability, found.reason) == (0, 1.0, None)


@pytest.mark.parametrize(
    ("changed", "reason", "words"),
    [
        ({"surroundings": Surroundings(square(1.0, 0.0, 0.5), ())}, Reason.START_BLOCKED, "start"),
        ({"surroundings": Surroundings(None, (square(-0.1, 0.0, 0.01),))}, Reason.START_BLOCKED, "start"),
        ({"surroundings": Surroundings(None, (square(0.1, 0.05, 0.05),))}, Reason.GOAL_BLOCKED, "goal"),
        ({"surroundings": Surroundings(square(-0.15, 0.0, 0.5), ())}, Reason.GOAL_BLOCKED, "goal"),
        ({"most_pushes": 1}, Reason.OUT_OF_REACH, "at most 1 pushes"),
        ({"goal": Region((50.0, 0.0, 0.0), 0.01, 0.1)}, Reason.OUT_OF_REACH, "the goal is 50.1 m away"),
        ({"surroundings": Surroundings(square(-0.1, 0.0, 0.14), ()), "goal": Region((-0.1, 0.0, np.pi), 0.01, 0.1)},
         Reason.OUT_OF_REACH, "touches nothing"),
    ],
)  # fmt: skip
def test_the_reason_why_there_is_no_plan(changed: dict[str, object], reason: Reason, words: str) -> None:
    """It has a code, and words with the figures."""
    found = planned(replace(TASK, **changed))  # type: ignore[arg-type]
    assert (found.reason, len(found.pushes), found.goal_probability) == (reason, 0, 0.0)
    assert words in found.detail


def test_an_object_without_a_push_that_moves_it_has_no_candidates() -> None:
    """A model in which everything misses leaves nothing to plan with."""

    class Missing(Mechanics):
        """Model of an object that no push touches."""

        def __call__(self, pushes: DoubleArray) -> PushOutcomes:
            """Miss."""
            found = super().__call__(pushes)
            return replace(found, misses=np.ones(len(pushes), dtype=np.bool_))

    assert planned(TASK, Missing()).reason is Reason.NO_CANDIDATES


def test_a_start_nearer_than_the_clearance_keeps_the_distance_that_it_has() -> None:
    """After a push that went astray, a plan is still made, away from the obstacle."""
    beside = Surroundings(None, (square(-0.1, 0.0621, 0.04),))  # 2.1 mm above the box
    found = planned(replace(TASK, goal=Region((-0.1, -0.1, 0.0), 0.01, 0.17), surroundings=beside))
    assert found.reason is None, found.detail


def test_a_clock_that_strikes_early_is_reported() -> None:
    """Before a sequence is found there is a reason, and after it a plan that says that it was stopped."""
    now = plan(Mechanics(), BOX, RADIUS_M, TASK, itertools.count(0.0, 1.0).__next__)
    assert (now.reason, now.stopped) == (Reason.TIME_OVER, True)
    one = replace(TASK, goal=Region((-0.08, 0.0, 0.0), 0.01, 0.3))
    late = plan(Mechanics(), BOX, RADIUS_M, one, itertools.count(0.0, 1.0).__next__)
    assert late.stopped
    assert len(late.pushes) == 1


def test_a_longer_budget_considers_more_pushes() -> None:
    """The number of candidates follows from the budget, within bounds."""
    counts = [planned(replace(TASK, time_s=time_s)).candidates for time_s in (0.05, 0.1, 2.0)]
    assert counts == sorted(counts)
    assert counts[0] <= 200 < counts[2] <= 2000


def test_a_plan_that_is_no_longer_wanted_ends_at_its_next_pause() -> None:
    """Candidates, search, and particles all pause, so the job ends wherever it is."""
    all_pauses = LateTurn(10_000)
    token = TURN.set(all_pauses)
    try:
        planned(TASK)
        count = 10_000 - all_pauses.left
        for pauses in (0, count // 2, count - 1):
            TURN.set(LateTurn(pauses))
            with pytest.raises(DeadlineError):
                planned(TASK)
    finally:
        TURN.reset(token)
    assert count > 20
