"""Benchmark of the simulation: a table that the scene itself made is met to the last digit, and repeats are counted."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.scene import chosen_part, error_table, errors, main, report, scatter_table
from service.pushing.outlines import Outline
from training.simulation.replay import replay, replay_even
from training.tables.push_table import PushTable, TableObject

BOX = Outline.of([(-0.04, -0.03), (0.04, -0.03), (0.04, 0.03), (-0.04, 0.03)])
PUSHES = 16


@pytest.fixture(scope="module")
def table() -> PushTable:
    """Return a table of pushes around a box, each twice, with the outcomes of one draw of the scene."""
    across = np.repeat(np.linspace(-0.03, 0.03, PUSHES // 2), 2)
    pushers = np.column_stack([np.full(PUSHES, -0.045), across, np.zeros(PUSHES), np.full(PUSHES, 0.05)])
    pushers[: PUSHES // 2] = (-1.0, 1.0, -1.0, 1.0) * pushers[: PUSHES // 2] + (0.0, 0.0, np.pi, 0.0)
    blank = PushTable(
        objects=(TableObject("box", BOX),),
        object_index=np.zeros(PUSHES, dtype=np.int64),
        pushers=pushers,
        outcomes=np.zeros((PUSHES, 3)),
        pusher_radius_m=np.full(PUSHES, 0.005),
        surfaces=("abs",),
        surface_index=np.zeros(PUSHES, dtype=np.int64),
        source="test",
        digest="",
    )
    return replace(blank, outcomes=replay(blank, 3, 1)[0])


def test_the_scene_meets_its_own_outcomes(table: PushTable) -> None:
    """Outcomes without variation have no error against themselves, and a turn by two pi is none."""
    even = replay_even(table)
    mm, deg = errors(even, even + np.array([0.003, 0.004, 2.0 * np.pi]))

    assert mm == pytest.approx(5.0)
    assert deg == pytest.approx(0.0, abs=1e-9)
    lines = error_table(replace(table, outcomes=even), even, even[None])
    assert lines[2].startswith("| all | 16 | 0.00 (0.00) | 0.00 (0.00) |")


def test_constants_are_chosen_on_a_part_and_reported_on_the_rest(table: PushTable) -> None:
    """Both parts have pushes, and pushes from one start are in one part."""
    part = chosen_part(table)

    assert 0 < part.sum() < len(part)
    assert (part[::2] == part[1::2]).all()


def test_repeats_are_compared_as_recorded(table: PushTable) -> None:
    """The table's own draw scatters by as much in the row of the scene as in that of the recordings."""
    lines = scatter_table(table, table.outcomes[None])

    assert lines[2].replace("recorded", "scene") == lines[3]
    assert f"| {PUSHES // 2} |" in lines[2]


def test_the_report_has_every_section(table: PushTable) -> None:
    """Errors, repeats, step, speed and MuJoCo."""
    text = "\n".join(report(table, 2, 2))

    for part in ("mean of 2 draws", "repeats on one plate", "against a quarter", "pushes a second", "MuJoCo, 1 ms"):
        assert part in text


def test_a_missing_table_is_one_line(tmp_path: Path) -> None:
    """The error names the folder, without a traceback."""
    with pytest.raises(SystemExit, match="error: "):
        main([str(tmp_path / "none")])
