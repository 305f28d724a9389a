"""Plans: pushes that bring an object from a pose to a goal, and how likely they do.

Candidates around the object are predicted once (``candidates``), a beam search composes their motions to sequences
(``search``), and particles that meet each push at their own poses tell how likely the best one reaches the goal and
touches an obstacle (``rollout``). The answer is meant to be replanned: push once, look, and plan again.

Planners of pushes sample. UNO Push (2024) and mppi-isaac run MPPI in a simulator for each control step, Arruda et al.
(2017) plan with learnt Gaussians and avoid uncertain pushes. Here the model is a network of which a prediction costs
more than a thousand products of motions, so predictions are shared by all sequences, and the deviations are a cost.

The work follows from the time budget by fixed numbers, so a seed gives the same plan on every machine. The clock only
stops a search that is slower than its budget, and the answer says so.
"""

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

import numpy as np
import numpy.typing as npt

from service.planning.candidates import Candidates, Pusher
from service.planning.particles import Region, moved
from service.planning.paths import FINE_M, Paths
from service.planning.push_model import PushModel
from service.planning.rollout import Rollout, rollout
from service.planning.search import Found, IsFree, Rows, Search, Sequence, ends_of
from service.planning.surroundings import Surroundings, Wave
from service.pushing.outlines import Outline
from service.pushing.poses import DoubleArray

MOST_PUSHES: Final = 20
CLEARANCE_M: Final = 0.005
TIME_S: Final = 0.3
SPREADS: Final = 1.0  # standard deviations of a corner that the first push keeps from obstacles beside the clearance
LEAST_TIME_S, MOST_TIME_S = 0.05, 2.0
ROWS_PER_S: Final = 8_000  # predictions for each second of the budget, which take less than half of it on an idle core
_SHARE: Final = 0.4  # of the predictions: candidates. The others are particles.
_CANDIDATES: Final = (200, 2000)
_WIDTHS: Final = (32, 64)  # of the beam
_POSES_PER_S: Final = 214  # of the beam: its most in 0.3 s
_PARTICLES: Final = (32, 1000)
_MOST_CHECKED: Final = 100  # particles whose ways are checked
_NO_PUSHES: Final = np.zeros((0, 4))
_CROWDED: Final = "the object touches an obstacle or leaves the workspace"
_LATE: Final = 0.5  # of the budget, beyond it: to count collisions
_LEAST_KEPT: Final = 0.8  # of the gap at the start, if it is less than the clearance


class Reason(StrEnum):
    """Reason why there is no plan."""

    START_BLOCKED = "start_blocked"
    GOAL_BLOCKED = "goal_blocked"
    NO_CANDIDATES = "no_candidates"
    OUT_OF_REACH = "out_of_reach"
    TIME_OVER = "time_over"


@dataclass(frozen=True, eq=False, slots=True)
class PlanTask:
    """Task: from where to where, with which pushes, among which obstacles.

    Attributes:
        start: (3,) pose of the object in the world.
        goal: region of poses.
        lengths_m: (l,) allowed lengths of a push, ascending.
        most_pushes: of a plan.
        surroundings: workspace and obstacles.
        clearance_m: that object and tip keep from both.
        time_s: budget.
        seed: of the particles.
    """

    start: DoubleArray
    goal: Region
    lengths_m: DoubleArray
    most_pushes: int
    surroundings: Surroundings
    clearance_m: float = CLEARANCE_M
    time_s: float = TIME_S
    seed: int = 0


@dataclass(frozen=True, eq=False, slots=True)
class Plan:
    """Plan, or the reason why there is none.

    Attributes:
        pushes: (k, 4) x_m, y_m, angle_rad, length_m of the tip in the world. None are needed at the goal, and none are
            given with a reason.
        outcome: rollout of the one sequence, or None without pushes.
        goal_probability: share of particles that end in the goal if all pushes are made without looking.
        replanned_probability: probability that the last push ends in the goal if the robot plans again after each
            push before it.
        collision_probability: (k,) share of particles of which object or tip touches something up to each push.
        reason: why there is no plan, or None.
        detail: the reason in words, with its figures.
        stopped: true if the time budget was over before the work was done.
        candidates: number of pushes that sequences were made of.
    """

    pushes: DoubleArray
    outcome: Rollout | None
    goal_probability: float
    replanned_probability: float
    collision_probability: DoubleArray
    reason: Reason | None
    detail: str
    stopped: bool
    candidates: int


def plan(model: PushModel, outline: Outline, radius_m: float, task: PlanTask, clock: Callable[[], float]) -> Plan:
    """Plan pushes of one object.

    Args:
        model: of the object.
        outline: of the object, in the object frame.
        radius_m: of the tip.
        task: see ``PlanTask``.
        clock: seconds since any moment.
    """
    return _Planner(Pusher(model, outline, radius_m, task.lengths_m), task, clock).plan()


class _Planner:
    """One plan, and the time until which it may take."""

    def __init__(self, pusher: Pusher, task: PlanTask, clock: Callable[[], float]) -> None:
        self._pusher, self._task, self._clock = pusher, task, clock
        self._until_s = clock() + task.time_s
        self._late_s = self._until_s + _LATE * task.time_s
        self._paths = self._paths_keeping(task.clearance_m, self._is_over)
        self._least_m = self._paths.kept_m
        rows = task.time_s * ROWS_PER_S
        self._candidates = round(float(np.clip(_SHARE * rows, *_CANDIDATES)))
        self._width = round(float(np.clip(_POSES_PER_S * task.time_s, *_WIDTHS)))
        self._particle_rows = (1.0 - _SHARE) * rows

    def plan(self) -> Plan:
        """Check start and goal, search, and tell how likely the best sequence reaches the goal."""
        task = self._task
        if task.goal.probability(task.start[None]) == 1.0:
            return Plan(_NO_PUSHES, None, 1.0, 1.0, np.zeros(0), None, "", stopped=False, candidates=0)
        gap_m = self._paths.gap_m(task.start)
        if gap_m <= 0.0:
            return self._none(Reason.START_BLOCKED, f"at the start {_CROWDED}")
        if _LEAST_KEPT * gap_m < self._least_m:  # finer samples, so that nothing lies between them here, too
            self._paths = self._paths_keeping(_LEAST_KEPT * gap_m, self._is_over)
            self._least_m = min(self._least_m, _LEAST_KEPT * gap_m)
        goal = np.array(task.goal.pose)
        if self._paths.gap_m(goal) < self._least_m:
            kept = f" by less than the clearance of {self._least_m * 1e3:.3g} mm"
            return self._none(Reason.GOAL_BLOCKED, f"at the goal {_CROWDED}, or clears them{kept}")
        furthest_m = 2.0 * task.most_pushes * float(task.lengths_m[-1])
        way_m = float(np.hypot(*(goal - task.start)[:2]))
        if way_m > furthest_m + 2.0 * self._paths.furthest_m + task.goal.position_tolerance_m:
            detail = (
                f"the goal is {way_m:.3g} m away, further than {task.most_pushes} pushes of these lengths can reach"
            )
            return self._none(Reason.OUT_OF_REACH, detail)
        candidates = self._pusher.candidates(self._pusher.spread(self._candidates), self._is_over)
        if not len(candidates.motions):
            return self._none(Reason.NO_CANDIDATES, "no push of these lengths starts clear of the object and moves it")
        found = self._searched(candidates, goal)
        if found.sequence is None:
            return self._without_sequence(found, candidates)
        return self._answer(found.sequence, found.is_complete, candidates)

    def _paths_keeping(self, clearance_m: float, is_over: Callable[[], bool]) -> Paths:
        pusher, task = self._pusher, self._task
        longest_m = float(task.lengths_m[-1])
        return Paths(task.surroundings, pusher.outline, pusher.radius_m, longest_m, clearance_m, is_over)

    def _is_over(self) -> bool:
        return self._clock() >= self._until_s

    def _searched(self, candidates: Candidates, goal: DoubleArray) -> Found:
        """Search with a sure first push among obstacles, and with any if there is none."""
        surroundings = self._task.surroundings
        centre = self._pusher.outline.centroid_m
        target = moved(goal, np.append(centre, 0.0))[:2]
        width_m = max(-float(self._pusher.outline.distance_m(centre[None])[0]), 0.0)
        wave = None if surroundings.is_empty else Wave.around(surroundings, target, width_m)

        def remaining_m(places: DoubleArray) -> DoubleArray:
            """Return how far (n,) it is from places (n, 2) to the goal."""
            if wave is not None:
                return wave.distance_m(places)
            straight: DoubleArray = np.hypot(places[:, 0] - target[0], places[:, 1] - target[1])
            return straight

        for spreads in (0.0,) if surroundings.is_empty else (SPREADS, 0.0):
            is_free = self._is_free(candidates, spreads)
            search = Search(candidates, self._task.goal, centre, remaining_m, is_free, self._is_over, self._width)
            found = search.run(self._task.start, self._task.most_pushes)
            if found.sequence is not None or self._is_over():
                break
        return found

    def _is_free(self, candidates: Candidates, spreads: float) -> IsFree:
        """Return the check of paths, in which first pushes keep some standard deviations of a corner more."""
        square = candidates.centre_std**2
        corner_m = np.sqrt((square[:, 0] + square[:, 1]) / 2.0 + self._paths.reach_m**2 * square[:, 2])

        def is_free(before: DoubleArray, after: DoubleArray, rows: Rows, is_first: bool) -> npt.NDArray[np.bool_]:
            """Return the pushes that touch nothing, see ``search.IsFree``."""
            pushes = placed(candidates.pushes[rows], before)
            spread_m = spreads * corner_m[rows] if is_first else 0.0
            return self._paths.free(before, after, pushes, self._least_m, spread_m)

        return is_free

    def _answer(self, best: Sequence, is_complete: bool, candidates: Candidates) -> Plan:
        task = self._task
        pushes = self._pushes(best, candidates)
        count = round(float(np.clip(self._particle_rows / len(pushes), *_PARTICLES)))
        outcome = rollout(self._pusher.model, task.start, pushes[None], count, task.seed)
        return Plan(
            pushes,
            outcome,
            float(task.goal.probability(outcome.particles[0, -1])),
            best.reached,
            self._collisions(pushes, outcome.particles[0]),
            None,
            "",
            stopped=self._is_over() or not is_complete,
            candidates=len(candidates.motions),
        )

    def _pushes(self, sequence: Sequence, candidates: Candidates) -> DoubleArray:
        """Return the pushes (k, 4) of a sequence in the world."""
        poses = ends_of(self._task.start, candidates.motions[sequence.rows])
        return placed(candidates.pushes[sequence.rows], poses[:-1])

    def _collisions(self, pushes: DoubleArray, particles: DoubleArray) -> DoubleArray:
        """Return the share (k,) of particles (k, p, 3) that touch something up to each push.

        Particles that are not checked before ``_late_s`` count as touching.
        """
        paths = self._paths_keeping(FINE_M, lambda: self._clock() >= self._late_s)
        particles = particles[:, :_MOST_CHECKED]
        free, found = np.ones(particles.shape[1], dtype=np.bool_), np.empty(len(pushes))
        before = np.broadcast_to(self._task.start, particles.shape[1:])
        for step, (push, after) in enumerate(zip(pushes, particles, strict=True)):
            free &= paths.free(before, after, np.broadcast_to(push, (len(free), 4)), 0.0)
            found[step] = 1.0 - float(free.mean())
            before = after
        return found

    def _without_sequence(self, found: Found, candidates: Candidates) -> Plan:
        task = self._task
        distance, turn = found.nearest
        best = f"the best ends {distance * 1e3:.3g} mm and {np.degrees(turn):.3g} degrees off"
        if self._is_over() or not found.is_complete:
            detail = f"the time of {task.time_s:g} s was over before a sequence reached the goal: {best}"
            return self._none(Reason.TIME_OVER, detail, candidates, stopped=True)
        among = "" if task.surroundings.is_empty else " and touches nothing"
        detail = f"no sequence of at most {task.most_pushes} pushes ends within the tolerance{among}: {best}"
        return self._none(Reason.OUT_OF_REACH, detail, candidates)

    def _none(self, reason: Reason, detail: str, candidates: Candidates | None = None, stopped: bool = False) -> Plan:
        count = 0 if candidates is None else len(candidates.motions)
        return Plan(_NO_PUSHES, None, 0.0, 0.0, np.zeros(0), reason, detail, stopped, count)


def placed(pushes: DoubleArray, poses: DoubleArray) -> DoubleArray:
    """Return pushes (n, 4) in the frames of objects at poses (n, 3) as pushes in the world."""
    return np.column_stack([moved(poses, pushes[:, :3]), pushes[:, 3]])
