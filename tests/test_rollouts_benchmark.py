"""Rollouts held against the truth: how pushes are chained and planned, and how regions are counted."""

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.push_measures import REGION_LIMITS, score
from benchmarks.rollout_sequences import chained, simulated
from benchmarks.rollouts import main, nearer
from benchmarks.rollouts_page import JUDGED, Findings, Row, StepScore, coverage_table, write_page
from service.planning.particles import moments
from service.planning.push_model import PushOutcomes
from service.pushing.outlines import Outline
from service.pushing.poses import DoubleArray, into_object_frame, wrap_angles
from service.pushing.shape_context import ShapeContext
from service.registry.registry import Registry
from tests.served_graphs import publish_shapes
from training.environments.tasks import draw_task
from training.tables.push_table import PushTable, TableObject
from training.tables.writing import write_table

BOX = Outline.of([(-0.05, -0.03), (0.05, -0.03), (0.05, 0.03), (-0.05, 0.03)])
WEDGE = Outline.of([(0.06, -0.02), (0.0, 0.04), (-0.06, -0.02)])


class Resting:
    """Model of an object that pushes do not move, as far as is known."""

    def __call__(self, pushes: DoubleArray) -> PushOutcomes:
        """Predict that nothing moves, within 2 mm and 0.02 rad."""
        zeros = np.zeros((len(pushes), 3))
        none = np.zeros(len(pushes), dtype=np.bool_)
        return PushOutcomes(zeros, zeros + np.array([0.002, 0.002, 0.02]), none, none, none)


def table(count: int) -> PushTable:
    """Return pushes of two objects on two surfaces. Each outcome names its row, so that chains can be followed."""
    rng = np.random.default_rng(2)
    numbers = np.arange(count)
    return PushTable(
        objects=(TableObject("box", BOX), TableObject("wedge", WEDGE, (0.0, 0.0), friction=0.3)),
        object_index=numbers % 2,
        pushers=np.column_stack([rng.uniform(-0.1, 0.1, (count, 2)), rng.uniform(-3, 3, count), np.full(count, 0.05)]),
        outcomes=np.column_stack([0.001 * (numbers + 1), rng.normal(0.0, 0.01, count), rng.normal(0.0, 0.5, count)]),
        pusher_radius_m=np.full(count, 0.005),
        surfaces=("abs", "wood"),
        surface_index=numbers // 2 % 2,
        source="made for a test",
        digest="0" * 64,
    )


def test_a_chain_composes_different_pushes_of_one_object_on_one_surface() -> None:
    """Seen from the true pose before it, each push and its outcome are those of a row of the table."""
    found = table(48)
    chains = list(chained(found, 10, 5, seed=1))

    assert [len(chain.poses) for chain in chains] == [3, 3, 2, 2]
    assert [chain.context.friction for chain in chains] == [None, None, 0.3, 0.3]
    for chain in chains:
        for pushes, poses in zip(chain.pushes, chain.poses, strict=True):
            before = np.vstack([chain.start, poses[:-1]])
            rows = np.rint(1e3 * into_object_frame(poses, before)[:, 0]).astype(int) - 1
            assert len(set(rows)) == 5
            assert len({(found.object_index[row], found.surface_index[row]) for row in rows}) == 1
            seen = into_object_frame(pushes[:, :3], before)
            seen[:, 2] = wrap_angles(seen[:, 2])
            assert seen == pytest.approx(found.pushers[rows, :3])
            moved = into_object_frame(poses, before)
            moved[:, 2] = wrap_angles(moved[:, 2])
            assert moved == pytest.approx(found.outcomes[rows])


def test_a_pair_with_too_few_pushes_is_left_out() -> None:
    """Five pushes cannot be drawn from four."""
    assert list(chained(table(16), 10, 5, seed=1)) == []


def test_simulated_pushes_are_fixed_before_the_first() -> None:
    """An object of another friction ends elsewhere after the same pushes, which touch it in the prediction."""
    task = draw_task("T", np.random.default_rng(6))
    context = ShapeContext(task.drawn.outline)
    one, other = (
        simulated(replace(task, drawn=replace(task.drawn, friction=friction)), context, Resting(), 2)
        for friction in (0.1, 0.6)
    )
    assert one is not None
    assert other is not None
    assert (one.pushes == other.pushes).all()
    assert (one.poses != other.poses).any()
    assert one.poses.shape == (1, 2, 3)
    assert np.hypot(*(one.poses[0, 0] - one.start)[:2]) > 0.001
    assert (one.pushes[..., 3] >= 0.02).all()
    assert (one.pushes[..., 3] <= 0.10).all()


def test_shares_of_nearer_particles_are_even_for_poses_of_the_cloud() -> None:
    """Poses from the distribution of the particles are nearer than 90 % of them in 90 % of the cases, and inside."""
    rng = np.random.default_rng(4)
    scale = (0.01, 0.002, 0.3)
    particles, poses = rng.normal(size=(600, 2, 200, 3)) * scale, rng.normal(size=(600, 2, 3)) * scale
    particles[..., 2] = wrap_angles(particles[..., 2] + math.pi)  # across the ends of the circle
    poses[..., 2] = wrap_angles(poses[..., 2] + math.pi)
    mean, covariance = moments(particles)
    share = nearer(poses, particles, mean, covariance)
    assert (share <= 0.9).mean() == pytest.approx(0.9, abs=0.03)
    assert share.mean() == pytest.approx(0.5, abs=0.03)
    found = score(poses[:, 0], mean[:, 0], covariance[:, 0]).calibration
    assert found is not None
    assert found.regions[1] == pytest.approx(0.9, abs=0.04)
    assert REGION_LIMITS[1] == pytest.approx(6.2514, abs=1e-4)


def findings(regions: tuple[float, ...]) -> Findings:
    """Return findings with one row, in which these shares of 100 poses are inside of the regions after each push."""
    steps = []
    for share in regions:
        poses = np.where(np.arange(100)[:, None] < 100 * share, 0.001, 0.1) * np.ones(3)
        found = score(poses, np.zeros((100, 3)), np.broadcast_to(np.eye(3) * 1e-4, (100, 3, 3)))
        steps.append(StepScore(found, 0.5, 14.0, 0.6))
    return Findings("a command", "a rig", "0" * 64, 64, (Row("MuJoCo", "the body", "push-shape@1", 100, tuple(steps)),))


def test_the_page_says_which_pushes_miss_the_goal(tmp_path: Path) -> None:
    """Shares after 1, 3 and 5 pushes are judged, and those between are drawn only."""
    write_page(tmp_path, findings((0.9, 0.5, 0.84, 0.5, 0.96)))
    page = (tmp_path / "README.md").read_text()
    assert "outside of the goal: 84.0 % after 3, 96.0 % after 5." in page
    assert "Origin of the recorded pushes: a rig (digest 00000000...)" in page
    assert (tmp_path / "coverage.png").read_bytes().startswith(b"\x89PNG")
    assert len(json.loads((tmp_path / "figures.json").read_text())["rows"][0]["steps"]) == 5
    write_page(tmp_path, findings((0.85, 0.5, 0.95, 0.5, 0.9)))
    assert "goal met" in (tmp_path / "README.md").read_text()
    assert "| MuJoCo | the body | push-shape@1 | 100 | 5 | 90.0 % | 50.0 % |" in coverage_table(findings((0.9,) * 5))


def test_the_command_scores_a_version_in_both_worlds(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The page has a row for each kind of sequences and each version, and the same again on another call."""
    publish_shapes(Registry(tmp_path / "models"))
    write_table(tmp_path / "table", table(48))
    out = tmp_path / "page"
    options = ["--recorded", str(tmp_path / "table"), "--models-folder", str(tmp_path / "models")]
    options += ["--unseen", str(tmp_path / "models"), "--source", "a rig of ours", "--out", str(out)]
    main([*options, "--sequences", "2", "--chains", "8", "--particles", "16"])
    assert "next: read" in capsys.readouterr().out
    page, figures = (out / "README.md").read_text(), (out / "figures.json").read_bytes()
    assert str(tmp_path) not in page
    assert "--recorded FOLDER --unseen build/unseen --sequences 2" in page
    rows = json.loads(figures)["rows"]
    assert [row["where"] for row in rows] == ["MuJoCo", "MuJoCo", "recorded"] * 2
    assert {row["version"] for row in rows} == {"push-shape@1", "without the four families"}
    assert [row["sequences"] for row in rows if row["where"] == "recorded"] == [8, 8]
    main([*options, "--sequences", "2", "--chains", "8", "--particles", "16"])
    assert (out / "figures.json").read_bytes() == figures


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--sequences", "0"], "are positive"),
        (["--particles", "5"], "10 or more"),
        (["--models-folder", "nowhere"], "registry cannot be listed"),
        (["--recorded", "nowhere"], "nowhere"),
    ],
)
def test_a_mistake_is_named(options: list[str], message: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Numbers that are none and folders that are missing end the command with a sentence."""
    with pytest.raises(SystemExit) as ended:
        main(options)
    assert message in str(ended.value) + capsys.readouterr().err


def test_the_page_in_the_documentation_is_that_of_its_figures(project_root: Path) -> None:
    """Every share in the table of docs/results/rollouts is in its figures, and the recorded pushes are credited."""
    folder = project_root / "docs" / "results" / "rollouts"
    page = (folder / "README.md").read_text(encoding="utf-8")
    figures = json.loads((folder / "figures.json").read_text(encoding="utf-8"))
    for row in figures["rows"]:
        for pushes in JUDGED:
            share = row["steps"][pushes - 1]["score"]["calibration"]["regions"][1]
            line = f"| {row['where']} | {row['knows']} | {row['version']} | {row['sequences']} | {pushes} "
            assert f"{line}| {100 * share:.1f} % |" in page
    assert "More than a million ways to be pushed" in page
