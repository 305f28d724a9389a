"""Closed-loop planning: tasks in MuJoCo, planners of them, the page, and the picture of the documentation."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from benchmarks import plan as benchmark
from benchmarks import plan_picture
from benchmarks.plan import (
    MECHANICS,
    PLANNERS,
    Decision,
    Scene,
    greedy,
    main,
    obstructed,
    quasi_static,
    run_task,
    scenes,
)
from benchmarks.plan_page import Measured, figures, table
from service.planning.paths import Paths
from service.planning.surroundings import Surroundings
from service.pushing.poses import DoubleArray
from service.registry.registry import Registry
from tests.served_graphs import publish_shapes

AMONG = PLANNERS[-1]


def measured(planner: str, reached: bool, pushes: int, touched: int = 0) -> Measured:
    """Return the result of a task."""
    return Measured(
        planner,
        reached,
        pushes,
        touched,
        20.0,
        5.0,
        [100.0] * pushes,
        [50.0] * pushes,
        [3.0] * pushes,
        [2.0] * pushes,
        "",
    )


def test_tasks_are_turned_by_up_to_half_a_turn_and_shared_by_all_planners() -> None:
    """Goals are 50 to 200 mm away, in a direction and turn of any kind, and the same with obstacles."""
    plain, among = scenes(12, MECHANICS), scenes(12, AMONG)
    for one, other in zip(plain, among, strict=True):
        apart = one.task.goal - one.task.start
        assert 0.05 <= np.hypot(apart[0], apart[1]) <= 0.2
        assert abs(apart[2]) <= np.pi
        assert np.array_equal(one.task.goal, other.task.goal)
        assert one.surroundings.is_empty
    assert max(abs(scene.task.goal[2] - scene.task.start[2]) for scene in plain) > np.pi / 2


def test_obstacles_leave_room_at_start_and_goal() -> None:
    """Both poses are 30 mm clear of every obstacle, and within the workspace."""
    found = scenes(6, AMONG)
    assert any(scene.surroundings.obstacles for scene in found)
    for scene in found:
        outline = scene.task.drawn.outline
        for obstacle in scene.surroundings.obstacles:
            paths = Paths(Surroundings(None, (obstacle,)), outline, 0.005, 0.1, 0.005)
            assert min(paths.gap_m(pose) for pose in (scene.task.start, scene.task.goal)) >= 0.03
        paths = Paths(scene.surroundings, outline, 0.005, 0.1, 0.005)
        assert min(paths.gap_m(pose) for pose in (scene.task.start, scene.task.goal)) > 0.0
    assert [str(each.corners) for each in obstructed(found[0].task, np.random.default_rng([0, 0])).obstacles] == [
        str(each.corners) for each in found[0].surroundings.obstacles
    ]


def test_a_greedy_planner_over_mechanics_reaches_most_goals() -> None:
    """A loop of plans and pushes in the simulator ends at the goal, or after ten pushes."""
    scene = scenes(1, MECHANICS)[0]
    drawn = scene.task.drawn
    found = run_task(scene, "greedy", greedy(scene, quasi_static(drawn.outline, drawn.pusher_radius_m)))
    assert len(found.wall_ms) == len(found.processor_ms) == len(found.error_mm) == found.pushes
    assert found.reached == (found.distance_mm <= 10.0 and found.turn_deg <= 10.0)
    assert found.touched == 0
    assert found.reached or found.pushes == 10


def test_a_task_without_a_plan_ends_with_its_reason() -> None:
    """No further push is made, and the plan's time counts."""

    def refuse(pose: DoubleArray, left: int) -> Decision:
        """Give up."""
        return Decision(None, pose, f"nothing for {left}")

    found = run_task(scenes(1, MECHANICS)[0], "idle", refuse)
    assert (found.reached, found.pushes, found.reason, len(found.wall_ms)) == (False, 0, "nothing for 10", 1)


def test_touches_are_counted_by_true_poses() -> None:
    """A push that carries the object into an obstacle counts, one beside it does not."""
    scene = scenes(1, MECHANICS)[0]
    start, drawn = scene.task.start, scene.task.drawn
    wall = scene.task.drawn.outline.corners - drawn.outline.centroid_m + start[:2] + np.array([0.5, 0.0])
    walled = Scene(scene.task, Surroundings(None, (type(drawn.outline).of(wall),)))
    away = np.array([start[0] - 1.0, start[1] - 1.0, 0.0, 0.05])
    assert walled.touches(start, start + np.array([0.5, 0.0, 0.0]), away)
    assert not walled.touches(start, start - np.array([0.1, 0.0, 0.0]), away)


def test_figures_count_goals_pushes_and_times() -> None:
    """Pushes are those of goals that were reached, and times those of all plans."""
    found = figures(
        [measured("a", True, 2), measured("a", True, 4, 1), measured("a", False, 10), measured("b", False, 1)]
    )
    assert found["a"]["reached"] == 2
    assert found["a"]["pushes_mean"] == 3.0
    assert found["a"]["touched"] == 1
    assert found["a"]["plan_ms"] == 100.0
    assert "| a | 2 of 3 | 3.00, 3 | 20 mm, 5 degrees off | 3.0 mm, 2.0 degrees | 100 ms (100) |" in table(found)
    assert "| 50 ms (50) | 1 of 16 pushes |" in table(found)
    assert "| b | 0 of 1 | -, - |" in table(found)


def test_the_page_of_one_task_is_written_and_a_second_run_reads_what_was_kept(
    tmp_path: Path, project_root: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Page, plot and figures come from the command, which pushes nothing twice."""
    models = tmp_path / "models"
    shutil.copytree(project_root / "models" / "push-none", models / "push-none")
    publish_shapes(Registry(models))
    given = ["--registry", str(models), "--other-registry", str(models), "--tasks", "1", "--planner", MECHANICS]
    given += ["--kept", str(tmp_path / "kept" / "tasks.jsonl"), "--out", str(tmp_path / "page")]
    main(given)
    first = capsys.readouterr().out
    monkeypatch.setattr(benchmark, "run_task", None)
    main(given)
    assert capsys.readouterr().out == first
    page = (tmp_path / "page" / "README.md").read_text()
    assert "python -m benchmarks.plan --tasks 1" in page
    document = json.loads((tmp_path / "page" / "figures.json").read_text())
    assert document["planners"][MECHANICS]["tasks"] == 1
    assert (tmp_path / "page" / "reached.png").stat().st_size > 5000


def test_models_that_are_not_there_are_named(tmp_path: Path) -> None:
    """An empty registry ends the command with one line."""
    (tmp_path / "models").mkdir()
    with pytest.raises(SystemExit) as ended:
        main(["--registry", str(tmp_path / "models"), "--out", str(tmp_path), "--kept", str(tmp_path / "kept.jsonl")])
    assert str(ended.value).startswith("error: ")


def test_the_picture_is_drawn_by_its_command(
    project_root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It shows every push until the goal, and is about as large as the one that is shipped."""
    monkeypatch.chdir(project_root)
    monkeypatch.setattr("service.api.planning.plan.monotonic", lambda: 0.0)
    plan_picture.main(["--out", str(tmp_path)])
    drawn, shipped = ((folder / "plan.png").stat().st_size for folder in (tmp_path, project_root / "docs" / "images"))
    assert drawn == pytest.approx(shipped, rel=0.5)
    assert shipped < 200_000
