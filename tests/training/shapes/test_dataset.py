"""Tables of pushes of drawn shapes: whole or not there, and the same however they were made."""

import hashlib
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from service.bulk.executors import choose_executor
from service.errors import DataError
from service.pushing.first_contact import first_contact
from service.pushing.outlines import Outline
from training.omnipush.declaration import DATASET_FILE
from training.omnipush.npy_files import write_npy
from training.shapes.dataset import PARTS, PUSH_LENGTHS_M, ShapePlan, draw_named, push_named, simulate_shapes
from training.shapes.families import chosen_families
from training.shapes.objects import FRICTIONS
from training.simulation.approach import LEAST_GAP_M
from training.simulation.bodies import Body, draw_body
from training.tables.push_table import PushTable
from training.tables.reading import read_table
from training.tables.splits import split_by_column

PLAN = ShapePlan(objects=3, pushes=4, seed=5, families=("box", "hammer"))
SLOW = ShapePlan(objects=8, pushes=40, families=("union",))
START_KILLED = """
from pathlib import Path
from service.bulk.executors import SerialExecutor
from training.shapes.dataset import ShapePlan, simulate_shapes
simulate_shapes(ShapePlan(objects=8, pushes=40, families=("union",)), Path({folder!r}), SerialExecutor(), quiet=True)
"""


def digests(folder: Path) -> dict[str, str]:
    """Return the sha256 of every file in a folder, by its relative path."""
    files = [path for path in folder.rglob("*") if path.is_file()]
    return {str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


def simulate(folder: Path, plan: ShapePlan = PLAN, jobs: int = 1) -> int:
    """Simulate a table without a progress bar."""
    return simulate_shapes(plan, folder, choose_executor(jobs), quiet=True)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of the table of ``PLAN``. Tests must not change it."""
    path = tmp_path_factory.mktemp("shapes")
    assert simulate(path) == 12
    return path


@pytest.fixture(scope="module")
def table(folder: Path) -> PushTable:
    """The table of ``PLAN`` as it is read."""
    return read_table(folder)


def test_the_table_has_the_objects_and_pushes_of_the_plan(folder: Path, table: PushTable) -> None:
    """Objects take turns among the families and are named by them, and the folder holds the table alone."""
    assert [item.name for item in table.objects] == ["box-0", "hammer-0", "box-1"]
    assert table.object_index.tolist() == [0] * 4 + [1] * 4 + [2] * 4
    assert sorted(digests(folder)) == [DATASET_FILE, "objects.parquet", "pushes.parquet"]
    for number, (family, place) in enumerate((("box", 0), ("hammer", 0), ("box", 1))):
        pushed = push_named(PLAN, family, place)
        rows = table.object_index == number
        assert np.array_equal(table.pushers[rows], pushed.pushers)
        assert np.array_equal(table.outcomes[rows], pushed.outcomes)
        assert set(table.pusher_radius_m[rows]) == {pushed.drawn.pusher_radius_m}
        assert table.objects[number].centre_of_mass_m == pushed.drawn.centre_of_mass_m
        assert table.objects[number].friction == pushed.drawn.friction


def test_the_table_says_that_it_is_simulated(table: PushTable) -> None:
    """No reader can take these pushes for recorded ones."""
    assert table.source.startswith("simulated pushes of drawn shapes")
    assert "seed 5" in table.source
    assert table.surfaces == ("simulated",)


def test_a_family_is_a_column_to_split_by(table: PushTable) -> None:
    """Holding out a family keeps all of its objects from the training part."""
    train, test = split_by_column(table, "family", "hammer")

    assert [item.name for item in train.objects] == ["box-0", "box-1"]
    assert [item.name for item in test.objects] == ["hammer-0"]


def test_pushes_are_drawn_over_the_whole_approach() -> None:
    """Lengths are 5 to 120 mm, starts lie clear of the object, and a tenth of the pushes miss it."""
    pushed = push_named(replace(PLAN, pushes=500), "L", 3)
    outline, lengths = pushed.drawn.outline, pushed.pushers[:, 3]

    travel = first_contact(outline, pushed.pushers, pushed.drawn.pusher_radius_m).travel_m
    gaps = outline.distance_m(pushed.pushers[:, :2]) - pushed.drawn.pusher_radius_m
    missed = travel > lengths
    assert PUSH_LENGTHS_M[0] <= lengths.min() < 0.006
    assert 0.100 < lengths.max() <= PUSH_LENGTHS_M[1]
    assert np.median(lengths) == pytest.approx(np.sqrt(np.prod(PUSH_LENGTHS_M)), rel=0.15)
    assert gaps.min() > 0.0
    assert missed.mean() == pytest.approx(0.1, abs=0.01)
    shares = (travel[~missed] - LEAST_GAP_M) / (lengths[~missed] - LEAST_GAP_M)
    assert np.histogram(shares, bins=4, range=(0.0, 1.0))[0].min() > 80
    assert np.abs(pushed.outcomes[missed]).max() < 0.002  # a tracker's noise
    assert (np.abs(pushed.outcomes[~missed]).max(axis=1) > 0.001).mean() > 0.8


def test_friction_of_an_object_is_that_of_its_pushes() -> None:
    """Objects of one seed differ in friction, over the whole range."""
    frictions = [push_named(replace(PLAN, pushes=1), "ellipse", number).drawn.friction for number in range(30)]

    assert min(frictions) < FRICTIONS[0] + 0.1
    assert max(frictions) > FRICTIONS[1] - 0.1


def test_files_do_not_depend_on_the_number_of_jobs(folder: Path, tmp_path: Path) -> None:
    """Two processes write the bytes that one writes."""
    simulate(tmp_path / "two", jobs=2)

    assert digests(tmp_path / "two") == digests(folder)


def test_a_killed_run_continues_to_the_same_bytes(tmp_path: Path) -> None:
    """A process that is killed by SIGKILL among its objects leaves parts, no table, and nothing to repair."""
    whole, killed = tmp_path / "whole", tmp_path / "killed"
    simulate(whole, SLOW)

    process = subprocess.Popen([sys.executable, "-c", START_KILLED.format(folder=str(killed))])
    deadline = time.monotonic() + 60.0
    while not list(killed.glob(f"{PARTS}/[!.]*")) and time.monotonic() < deadline:
        time.sleep(0.002)
    process.send_signal(signal.SIGKILL)
    process.wait()
    kept = len(list(killed.glob(f"{PARTS}/[!.]*")))

    assert 1 <= kept < SLOW.objects
    assert not list(killed.glob("*.parquet"))
    assert simulate(killed, SLOW) == (SLOW.objects - kept) * SLOW.pushes
    assert digests(killed) == digests(whole)


def test_a_table_that_is_there_is_kept(folder: Path, tmp_path: Path) -> None:
    """A second run simulates no push, and removes the parts that a kill after the table has left."""
    simulate(tmp_path)
    (tmp_path / PARTS).mkdir()

    assert simulate(tmp_path) == 0
    assert digests(tmp_path) == digests(folder)
    assert not (tmp_path / PARTS).exists()


def test_held_out_families_do_not_change_the_other_objects() -> None:
    """A hammer is the same hammer, whichever other families there are."""
    few, many = (replace(PLAN, families=chosen_families(names)) for names in (["tools"], []))

    assert np.array_equal(push_named(few, "hammer", 2).outcomes, push_named(many, "hammer", 2).outcomes)
    assert not np.array_equal(
        push_named(few, "hammer", 2).outcomes, push_named(replace(few, seed=6), "hammer", 2).outcomes
    )
    assert {family for family, _ in replace(PLAN, objects=99, families=chosen_families([], ["tools"])).names} == set(
        chosen_families([], ["tools"])
    )


def test_an_object_that_no_feet_balance_is_drawn_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """A centre of mass that the feet do not surround is rare, and does not end a run."""
    seen: list[Outline] = []

    def fail_once(outline: Outline, *others: Any) -> Body:
        seen.append(outline)
        if len(seen) == 1:
            raise ValueError("the centre of mass lies outside of the feet")
        return draw_body(outline, *others)

    monkeypatch.setattr("training.shapes.dataset.draw_body", fail_once)
    drawn, body, _ = draw_named(PLAN, "bar", 0)

    assert drawn.outline is body.outline is seen[1]
    assert not np.array_equal(seen[0].corners, seen[1].corners)


@pytest.mark.parametrize(
    "other",
    [replace(PLAN, seed=6), replace(PLAN, objects=4), replace(PLAN, pushes=5), replace(PLAN, families=("box",))],
)
def test_a_folder_of_another_table_is_refused(folder: Path, other: ShapePlan) -> None:
    """Another seed, number of objects or choice of families needs a folder of its own."""
    before = digests(folder)

    with pytest.raises(DataError, match="declares another dataset; give an empty folder"):
        simulate(folder, other)
    assert digests(folder) == before


def test_a_folder_of_undeclared_pushes_is_refused(folder: Path, tmp_path: Path) -> None:
    """A laboratory's own table is never declared as simulated."""
    (tmp_path / "pushes.parquet").write_bytes((folder / "pushes.parquet").read_bytes())

    with pytest.raises(DataError, match="holds a table of other pushes; give an empty folder"):
        simulate(tmp_path)
    assert sorted(digests(tmp_path)) == ["pushes.parquet"]


def test_a_part_that_is_no_part_is_refused(tmp_path: Path) -> None:
    """A part of another shape, or with a number that is not finite, is named, with the cure."""
    simulate(tmp_path)
    for path in tmp_path.glob("*.parquet"):
        path.unlink()
    (tmp_path / PARTS).mkdir()

    for rows in (np.zeros((4, 6)), np.full((4, 7), np.nan)):
        write_npy(tmp_path / PARTS / "box-0.npy", rows)
        with pytest.raises(DataError, match=r"box-0.npy is not the pushes .*remove it, and start again"):
            simulate(tmp_path)


def test_a_table_of_too_many_pushes_is_refused_before_anything_is_drawn() -> None:
    """The limit of a table is told at once."""
    with pytest.raises(DataError, match="more than the 10000000 pushes of a table"):
        ShapePlan(objects=100_001, pushes=100)
