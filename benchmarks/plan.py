"""Closed-loop planning in MuJoCo: objects that a model never saw are pushed to goals, with a new plan after each push.

    cazsl-train publish runs/push-shape --registry build/unseen   (the run that holds families out)
    python -m benchmarks.plan [--registry build/unseen] [--tasks 100] [--out docs/results/plan]

A task is a drawn object 50 to 200 mm across of a family that was held out, on a table in MuJoCo
(``training.environments``). Its goal is 50 to 200 mm away and turned by up to 180 degrees. Centre of mass, friction of
pusher and object, spread of the weight, and the table's friction under each push are drawn, and no planner knows them.
It knows outline, tip and pose. It may push ten times, and plans again after each push.

The planners have the same tasks: the plan of the service with push-shape, with quasi-static mechanics, and with
push-none, and a greedy one that makes the single push whose end push-shape expects nearest to the goal. The first two
have them among two obstacles in a workspace, too. The work of a plan is that of a budget of 0.3 s. The clock does not
stop it, so that the figures repeat. Results are kept in a file, one line for each task, and a run that was ended goes
on.
"""

import argparse
import json
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
from tqdm import tqdm

from benchmarks.plan_page import Measured, write_page
from benchmarks.real_pushes import make_folder
from service.errors import CazslError
from service.inference.object_model import ObjectModel
from service.inference.query import FIRST_CONTEXT, ContextBatch
from service.model.loaded_model import LoadedModel
from service.model.predictor import OnnxPredictor
from service.model.reference import ModelReference
from service.model.tensors import ContextKind
from service.planning.candidates import Pusher
from service.planning.particles import Region, moved
from service.planning.paths import Paths
from service.planning.plan import PlanTask, placed, plan
from service.planning.push_model import PushModel, PushOutcomes
from service.planning.surroundings import Surroundings
from service.pushing import mechanics
from service.pushing.outlines import Outline
from service.pushing.poses import PUSH_LENGTH_M, DoubleArray, wrap_angles
from service.pushing.shape_context import ShapeContext
from service.registry.loading import load_version
from service.registry.location import open_registry, trusted_keys
from training.environments.tasks import Task, draw_tasks
from training.fitting.shape_samples import HELD_OUT_FAMILIES

POSITION_M: Final = 0.010
ANGLE_RAD: Final = float(np.radians(10.0))
MOST_PUSHES: Final = 10
TIME_S: Final = 0.3
LENGTHS_M: Final = (0.02, 0.05, 0.10)
SEED: Final = 0
SHAPE, MECHANICS, NONE, GREEDY = "push-shape", "mechanics", "push-none", "greedy push"
_AMONG: Final = " among obstacles"
PLANNERS: Final = (SHAPE, MECHANICS, NONE, GREEDY, SHAPE + _AMONG, MECHANICS + _AMONG)
_CANDIDATES: Final = 960  # of the greedy planner, as many as those of a plan
_OBSTACLE_M: Final = 0.05  # side of a square
_OBSTACLES: Final = 2
_ROOM_M: Final = 0.03  # between an obstacle and the object at start and goal
_MARGIN_M: Final = 0.2  # of the workspace around both
_TRIES: Final = 200
_CLEARANCE_M: Final = 0.005
_SURE: Final = 1e-6  # deviation of mechanics, which has none


@dataclass(frozen=True, eq=False)
class Decision:
    """Decision for a push, or against any.

    Attributes:
        push: (4,) in the world, or None.
        expected: (3,) pose of the object after it.
        reason: why there is no push, or an empty text.
    """

    push: DoubleArray | None
    expected: DoubleArray
    reason: str = ""


Decide = Callable[[DoubleArray, int], Decision]
"""Function of the object's pose (3,) and the pushes that are left."""


@dataclass(frozen=True, eq=False)
class Scene:
    """A task with what surrounds it, and how often something was touched."""

    task: Task
    surroundings: Surroundings

    def goal(self) -> Region:
        """Return the region that the object has to reach."""
        x, y, yaw = self.task.goal.tolist()
        return Region((x, y, yaw), POSITION_M, ANGLE_RAD)

    def touches(self, before: DoubleArray, after: DoubleArray, push: DoubleArray) -> bool:
        """Return True if object or tip touched something on a push, by even steps between both true poses."""
        drawn = self.task.drawn
        paths = Paths(self.surroundings, drawn.outline, drawn.pusher_radius_m, float(push[3]), _CLEARANCE_M)
        return not bool(paths.free(before[None], after[None], push[None], 0.0)[0])


def run_task(scene: Scene, planner: str, decide: Decide) -> Measured:
    """Push until the goal is reached, no plan is found, or ten pushes were made."""
    table, goal = scene.task.tabletop(), scene.goal()
    wall_ms: list[float] = []
    processor_ms: list[float] = []
    errors: list[tuple[float, float]] = []
    touched, reason = 0, ""
    while goal.probability(table.pose[None]) < 1.0 and len(errors) < MOST_PUSHES:
        began, worked = time.perf_counter(), time.process_time()
        decision = decide(table.pose, MOST_PUSHES - len(errors))
        wall_ms.append(1e3 * (time.perf_counter() - began))
        processor_ms.append(1e3 * (time.process_time() - worked))
        if decision.push is None:
            reason = decision.reason
            break
        before = table.pose
        touched += scene.touches(before, table.push(decision.push), decision.push)
        errors.append(apart(table.pose, decision.expected))
    reached = bool(goal.probability(table.pose[None]) == 1.0)
    distance_mm, turn_deg = apart(table.pose, scene.task.goal)
    return Measured(
        planner,
        reached,
        len(errors),
        touched,
        distance_mm,
        turn_deg,
        wall_ms,
        processor_ms,
        [distance for distance, _ in errors],
        [turn for _, turn in errors],
        reason,
    )


def apart(pose: DoubleArray, other: DoubleArray) -> tuple[float, float]:
    """Return the distance in mm and the turn in degrees between two poses (3,)."""
    off = pose - other
    return float(1e3 * np.hypot(off[0], off[1])), float(np.degrees(abs(wrap_angles(off[2:])[0])))


class Contestants:
    """The planners, each of which decides on the pushes of one scene."""

    def __init__(self, shape: LoadedModel, none: LoadedModel) -> None:
        self._shape, self._none = shape, none

    def decide(self, planner: str, scene: Scene) -> Decide:
        """Return the decisions of a planner for one scene."""
        outline, radius_m = scene.task.drawn.outline, scene.task.drawn.pusher_radius_m
        if planner.removesuffix(_AMONG) == MECHANICS:
            return self._planned(scene, quasi_static(outline, radius_m), LENGTHS_M)
        if planner == NONE:
            unknown = ObjectModel(self._none, ContextBatch(ContextKind.NONE, (), None, "context"))
            return self._planned(scene, unknown, (PUSH_LENGTH_M,))
        tensors = tuple(tensor[None] for tensor in ShapeContext(outline, pusher_radius_m=radius_m).tensors())
        known = ObjectModel(self._shape, ContextBatch(ContextKind.SHAPE, tensors, FIRST_CONTEXT, "context"))
        return greedy(scene, known) if planner == GREEDY else self._planned(scene, known, LENGTHS_M)

    def _planned(self, scene: Scene, model: PushModel, lengths_m: Sequence[float]) -> Decide:
        drawn = scene.task.drawn

        def decide(pose: DoubleArray, left: int) -> Decision:
            """Return the first push of a plan, or why there is none."""
            task = PlanTask(
                pose, scene.goal(), np.array(lengths_m), left, scene.surroundings, _CLEARANCE_M, TIME_S, SEED
            )
            found = plan(model, drawn.outline, drawn.pusher_radius_m, task, lambda: 0.0)
            if found.outcome is None:
                return Decision(None, pose, str(found.reason))
            return Decision(found.pushes[0], found.outcome.moments().mean[0, 0])

        return decide


def greedy(scene: Scene, model: PushModel) -> Decide:
    """Return decisions for the one push that is expected to end nearest to the goal, in tolerances."""
    drawn, goal = scene.task.drawn, scene.task.goal
    pusher = Pusher(model, drawn.outline, drawn.pusher_radius_m, np.array(LENGTHS_M))

    def decide(pose: DoubleArray, _: int) -> Decision:
        """Return the push whose end is nearest."""
        found = pusher.candidates(pusher.spread(_CANDIDATES), lambda: False)
        ends = moved(pose, found.motions)
        distance = np.hypot(ends[:, 0] - goal[0], ends[:, 1] - goal[1]) / POSITION_M
        turn = wrap_angles(ends[:, 2] - goal[2]) / ANGLE_RAD
        best = int((distance**2 + turn**2).argmin())
        return Decision(placed(found.pushes[best : best + 1], pose[None])[0], ends[best])

    return decide


def quasi_static(outline: Outline, radius_m: float) -> PushModel:
    """Return quasi-static mechanics of an object that presses evenly, as a model that is always sure."""

    def model(pushes: DoubleArray) -> PushOutcomes:
        """Predict pushes (n, 4)."""
        mean = mechanics.push(outline, pushes, radius_m)
        never = np.zeros(len(pushes), dtype=np.bool_)
        return PushOutcomes(mean, np.full(mean.shape, _SURE), (mean == 0.0).all(axis=1), never, never)

    return model


def obstructed(task: Task, rng: np.random.Generator) -> Surroundings:
    """Return a workspace around start and goal of a task, with square obstacles that leave room for both."""
    outline, poses = task.drawn.outline, np.stack([task.start, task.goal])
    placed_corners = moved(poses[:, None], np.pad(outline.corners, ((0, 0), (0, 1)))[None])[..., :2].reshape(-1, 2)
    low, high = placed_corners.min(axis=0), placed_corners.max(axis=0)
    obstacles: list[Outline] = []
    for _ in range(_TRIES):
        if len(obstacles) == _OBSTACLES:
            break
        middle = rng.uniform(low, high)
        square = middle + _OBSTACLE_M / 2.0 * np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])
        alone = Surroundings(None, (Outline.of(square),), poses[:, :2])
        paths = Paths(alone, outline, task.drawn.pusher_radius_m, LENGTHS_M[-1], _CLEARANCE_M)
        if min(paths.gap_m(pose) for pose in poses) >= _ROOM_M:
            obstacles += alone.obstacles
    low, high = low - _MARGIN_M, high + _MARGIN_M
    room = Outline.of([[low[0], low[1]], [high[0], low[1]], [high[0], high[1]], [low[0], high[1]]])
    return Surroundings(room, tuple(obstacles), poses[:, :2])


def scenes(count: int, planner: str) -> list[Scene]:
    """Return the scenes of a planner. A scene does not depend on how many there are."""
    tasks = [turned(task) for task in draw_tasks(HELD_OUT_FAMILIES, count, SEED)]
    free = Surroundings(None, ())
    return [
        Scene(task, obstructed(task, np.random.default_rng([SEED, number])) if planner.endswith(_AMONG) else free)
        for number, task in enumerate(tasks)
    ]


def turned(task: Task) -> Task:
    """Return a task whose goal is turned twice as far: by up to 180 degrees."""
    return replace(task, goal=task.goal + np.array([0.0, 0.0, task.goal[2] - task.start[2]]))


def measured_tasks(
    kept: Path, contestants: Contestants, planners: Sequence[str], count: int, model: str
) -> Iterator[Measured]:
    """Yield the results of all planners and tasks. Those of the same model in a file are read, others added to it."""
    known = {}
    if kept.exists():
        for line in kept.read_text().splitlines():
            found = json.loads(line)
            if found.pop("model") == model:
                number = found.pop("task")
                known[found["planner"], number] = Measured(**found)
    for planner in planners:
        for number, scene in enumerate(tqdm(scenes(count, planner), desc=planner, unit="task", disable=None)):
            result = known.get((planner, number))
            if result is None:
                result = run_task(scene, planner, contestants.decide(planner, scene))
                with kept.open("a") as file:
                    file.write(json.dumps({"model": model, "task": number, **asdict(result)}) + "\n")
            yield result


def load_champion(registry: str, name: str) -> LoadedModel:
    """Load the champion of a model, verified."""
    opened = open_registry(registry, trusted_keys(""))
    return load_version(opened, OnnxPredictor, name, opened.resolve(ModelReference.parse(name)))


def main(arguments: Sequence[str] | None = None) -> None:
    """Run all planners on all tasks, print their table and write the page."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.plan", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--registry", default="build/unseen", help="models with push-shape (build/unseen)")
    parser.add_argument("--other-registry", default="models", help="models with push-none (models)")
    parser.add_argument("--tasks", type=int, default=100, help="number of tasks (100)")
    parser.add_argument("--planner", action="append", choices=PLANNERS, help="a planner, for several: again (all)")
    parser.add_argument("--kept", type=Path, default=Path("build/plan.jsonl"), help="results so far (build/plan.jsonl)")
    parser.add_argument("--out", type=Path, default=Path("docs/results/plan"), help="folder of the page")
    options = parser.parse_args(arguments)
    try:
        make_folder(options.out)
        make_folder(options.kept.parent)
        shape = load_champion(options.registry, "push-shape")
        contestants = Contestants(shape, load_champion(options.other_registry, "push-none"))
    except CazslError as error:
        sys.exit(f"error: {error}")
    digest = shape.manifest.files["model.onnx"].sha256
    results = list(measured_tasks(options.kept, contestants, options.planner or PLANNERS, options.tasks, digest))
    print(write_page(options.out, shape.manifest, options.tasks, results))


if __name__ == "__main__":
    main()
