"""Simulated datasets: files that depend on plan and seed alone, and statistics beside Omnipush's."""

import hashlib
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from service.errors import DataError
from service.pushing.poses import PUSH_LENGTH_M
from training.inspection.statistics import QUANTITIES, compare_statistics, missed, motion_quantiles
from training.omnipush.declaration import DATASET_FILE
from training.omnipush.published import (
    omnipush_descriptors,
    published_normalisation,
    recorded_outcomes,
    weight_count,
)
from training.omnipush.pushes import OUTCOME_SUFFIX, PUSHER_SUFFIX, Pushes, read_folder
from training.simulation.dataset import PUSHER_STD_M, Simulation, record, simulate_dataset
from training.simulation.plans import APPROACH, PLANS, RING, Plan
from training.simulation.surfaces import PLYWOOD

WANTED = Simulation(("1a2b3c4a", "2B3a2C1a", "4a4a4a4a"), pushes_per_object=3, seed=7)
RING_SHA256 = (
    "b6629a53d801b52420a45646a48ca32e585c865fb3d3cfed9467d0a03372c574",  # with AVX-512
    "db0f77cda7b655edf547c7f04721b47f907a06e7359e1425ac43137770ee6566",
)
APPROACH_SHA256 = "a75d14ff84d85f5683678b2f7042515f02787db09ac7b9f93f18d243e23a41f9"
SIMULATE_A_LITTLE = """
import sys, pathlib
from training.simulation.dataset import Simulation, simulate_dataset
simulate_dataset(Simulation(("1a2C3b4a",), 20, seed=3), pathlib.Path(sys.argv[1]), threads=1, quiet=True)
"""


def digests(folder: Path) -> dict[str, str]:
    """Return the sha256 of every file in a folder, without hidden part files."""
    return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in folder.glob("[!.]*")}


def digest(folder: Path) -> str:
    """Return one sha256 of the names and bytes of all files in a folder."""
    found = hashlib.sha256()
    for path in sorted(folder.iterdir()):
        found.update(path.name.encode() + path.read_bytes())
    return found.hexdigest()


@pytest.fixture(scope="module")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with a small dataset that was simulated in one go on one thread. Tests must not change it."""
    folder = tmp_path_factory.mktemp("simulated")
    simulate_dataset(WANTED, folder, threads=1, quiet=True)
    return folder


@pytest.fixture(scope="module")
def sample(tmp_path_factory: pytest.TempPathFactory) -> Pushes:
    """Twelve pushes of every tenth object of the benchmark, by the plan ``RING``."""
    folder = tmp_path_factory.mktemp("sample")
    wanted = Simulation(omnipush_descriptors()[::10], 12, seed=1, plan=RING)
    simulate_dataset(wanted, folder, threads=2, quiet=True)
    return read_folder(folder)


def test_the_files_do_not_depend_on_the_number_of_threads(simulated: Path, tmp_path: Path) -> None:
    """One thread and three write the same bytes."""
    simulate_dataset(WANTED, tmp_path, threads=3, quiet=True)

    assert digests(tmp_path) == digests(simulated)


def test_an_object_does_not_depend_on_the_others(simulated: Path, tmp_path: Path) -> None:
    """Every object has its own random stream, so an object simulated alone has the same files."""
    alone = WANTED.descriptors[1]
    simulate_dataset(replace(WANTED, descriptors=(alone,)), tmp_path, threads=1, quiet=True)

    expected = digests(simulated)
    assert digests(tmp_path) == {
        name: expected[name] for name in (DATASET_FILE, alone + PUSHER_SUFFIX, alone + OUTCOME_SUFFIX)
    }


def test_objects_and_seeds_have_streams_of_their_own(simulated: Path, tmp_path: Path) -> None:
    """Two objects, or one object under two seeds, get different pushes."""
    simulate_dataset(replace(WANTED, seed=8, descriptors=WANTED.descriptors[:1]), tmp_path, threads=1, quiet=True)

    pushers = [*read_folder(simulated).pushers, *read_folder(tmp_path).pushers]
    assert len({array.tobytes() for array in pushers}) == len(WANTED.descriptors) + 1


def lose_an_object(folder: Path) -> None:
    """Interrupt: both files of an object are gone."""
    (folder / (WANTED.descriptors[0] + PUSHER_SUFFIX)).unlink()
    (folder / (WANTED.descriptors[0] + OUTCOME_SUFFIX)).unlink()


def die_between_the_files(folder: Path) -> None:
    """Interrupt: the pusher file was written, the outcome file was not."""
    (folder / (WANTED.descriptors[0] + OUTCOME_SUFFIX)).unlink()


def die_within_a_file(folder: Path) -> None:
    """Interrupt: the outcome file was half written beside its place."""
    path = folder / (WANTED.descriptors[0] + OUTCOME_SUFFIX)
    content = path.read_bytes()
    path.unlink()
    path.with_name(f".{path.name}.part").write_bytes(content[: len(content) // 2])


@pytest.mark.parametrize(
    "interrupt",
    [
        pytest.param(lose_an_object, id="before an object"),
        pytest.param(die_between_the_files, id="between its files"),
        pytest.param(die_within_a_file, id="within a file"),
    ],
)
def test_an_interrupted_simulation_goes_on(simulated: Path, tmp_path: Path, interrupt: Callable[[Path], None]) -> None:
    """A simulation started again completes the same folder and leaves finished objects untouched."""
    folder = tmp_path / "interrupted"
    shutil.copytree(simulated, folder)
    interrupt(folder)
    finished = {
        path: path.stat().st_mtime_ns for path in folder.glob("*.npy") if WANTED.descriptors[0] not in path.name
    }

    simulate_dataset(WANTED, folder, threads=1, quiet=True)

    assert digests(folder) == digests(simulated)
    assert read_folder(folder).digest == read_folder(simulated).digest
    assert len(finished) == 4
    assert {path: path.stat().st_mtime_ns for path in finished} == finished


@pytest.mark.parametrize(
    "other",
    [
        pytest.param(replace(WANTED, seed=8), id="another seed"),
        pytest.param(replace(WANTED, pushes_per_object=4), id="another number of pushes"),
        pytest.param(replace(WANTED, surface=PLYWOOD), id="another surface"),
        pytest.param(replace(WANTED, plan=RING), id="another plan"),
    ],
)
def test_another_dataset_in_the_same_folder_is_refused(simulated: Path, tmp_path: Path, other: Simulation) -> None:
    """A folder holds one dataset, and a refused one leaves it unchanged."""
    folder = tmp_path / "taken"
    shutil.copytree(simulated, folder)

    with pytest.raises(DataError, match="declares another dataset") as caught:
        simulate_dataset(other, folder, threads=1, quiet=True)

    assert str(folder) in str(caught.value)
    assert digests(folder) == digests(simulated)


def test_simulated_pushes_never_join_undeclared_ones(simulated: Path, tmp_path: Path) -> None:
    """A folder that may hold the real files is refused, so that simulated and real pushes are never mixed."""
    name = WANTED.descriptors[0] + PUSHER_SUFFIX
    shutil.copy(simulated / name, tmp_path / name)

    with pytest.raises(DataError, match="not declared as simulated") as caught:
        simulate_dataset(WANTED, tmp_path, threads=1, quiet=True)

    assert str(tmp_path) in str(caught.value)
    assert [path.name for path in tmp_path.iterdir()] == [name]


def test_a_simulated_folder_declares_itself(simulated: Path) -> None:
    """The source of simulated pushes, which goes into cards and manifests, says simulated, simulator, plan and seed."""
    source = read_folder(simulated).source

    assert "simulated" in source
    assert "quasi-static" in source
    assert "plan approach" in source
    assert "seed 7" in source


def test_the_ring_keeps_its_bytes(tmp_path: Path) -> None:
    """The plan of the published tables writes the bytes of then: one of two digests, by numpy's arctangent."""
    wanted = Simulation(("1a2b3c4a",), pushes_per_object=20, surface=PLYWOOD, plan=RING)
    simulate_dataset(wanted, tmp_path, threads=1, quiet=True)

    with_avx512, without = RING_SHA256
    assert digest(tmp_path) in (with_avx512, without)


@pytest.mark.parametrize("disabled", ["", "X86_V4 AVX512_ICL AVX512_SPR", "X86_V3 X86_V4 AVX512_ICL AVX512_SPR"])
def test_the_default_plan_has_the_same_bytes_on_every_processor(tmp_path: Path, disabled: str) -> None:
    """A tiny dataset has a pinned digest, however much of the processor's instructions numpy may use."""
    command = [sys.executable, "-c", SIMULATE_A_LITTLE, str(tmp_path)]
    environment = {
        **os.environ,
        "NPY_DISABLE_CPU_FEATURES": disabled,
        "OPENBLAS_CORETYPE": "Haswell" if disabled else "",
    }
    subprocess.run(command, env=environment, check=True, timeout=120)

    assert digest(tmp_path) == APPROACH_SHA256


@pytest.mark.parametrize("plan", [pytest.param(plan, id=plan.name) for plan in PLANS.values()])
def test_records_are_unbiased_and_have_the_tracker_s_noise(plan: Plan) -> None:
    """Records are unbiased, have the tracker's spread, and express the heading of the push in the measured frame."""
    rng = np.random.default_rng(4)
    pushers, outcomes = np.tile((-0.08, 0.01, 0.1), (4000, 1)), np.tile((0.0, 0.0, 0.2), (4000, 1))
    recorded_pushers, recorded_outcomes = record(pushers, outcomes, rng, plan)
    noise = np.array(plan.tracker_std)

    # A twelfth of the noise is six standard errors of 4000 records. The frame's own yaw moves a point 80 mm away.
    assert (np.abs((recorded_outcomes - outcomes).mean(axis=0)) < noise / 6).all()
    assert (recorded_outcomes - outcomes).std(axis=0) == pytest.approx(np.sqrt(2) * noise, rel=0.1)
    across = np.sqrt((0.08 * noise[2]) ** 2 + noise[1] ** 2 + PUSHER_STD_M**2)
    assert (recorded_pushers - pushers).std(axis=0)[1] == pytest.approx(across, rel=0.1)
    assert (recorded_pushers - pushers).std(axis=0)[2] == pytest.approx(noise[2], rel=0.1)


def test_two_readings_differ_as_those_of_the_recordings() -> None:
    """An object that is not touched is read 0.0235 mm and 0.33 mrad apart (std), as in Omnipush's recordings."""
    still = np.zeros((4000, 3))
    _, outcomes = record(still, still, np.random.default_rng(6), APPROACH)

    assert outcomes.std(axis=0) == pytest.approx([0.0235e-3, 0.0235e-3, 0.33e-3], rel=0.05)


def test_objects_move_away_from_the_pusher_and_no_further_than_it_went(sample: Pushes) -> None:
    """Along the push every object moves by 0 to 50 mm, within the tracker's noise."""
    angle = sample.pushers[..., 2]
    along = sample.outcomes[..., 0] * np.cos(angle) + sample.outcomes[..., 1] * np.sin(angle)

    assert along.shape == (25, 12)
    assert along.min() > -0.001
    assert along.max() < PUSH_LENGTH_M + 0.001


def test_hardly_any_push_of_the_ring_misses(sample: Pushes) -> None:
    """Less than 2 % of the pushes of the benchmark's objects leave them in place."""
    assert missed(sample.outcomes).mean() < 0.02


def test_simulated_pushes_are_spread_like_the_published_ones(sample: Pushes) -> None:
    """Every standard deviation is within 15 % of Omnipush's.

    A standard deviation of 300 pushes has a sampling error of about 1 / sqrt(600), 4 %. That of the yaw with its heavy
    tails is larger. The whole dataset agrees within 5 %, and 15 % leaves two and a half sampling errors beside that.
    """
    figures = compare_statistics(*sample.rows(), published_normalisation())

    assert [figure.quantity for figure in figures] == list(QUANTITIES)
    assert [figure.ratio for figure in figures] == pytest.approx([1.0] * 6, abs=0.15)


@pytest.fixture(scope="module")
def approached(tmp_path_factory: pytest.TempPathFactory) -> Pushes:
    """Sixty pushes of every third object without weights, by the default plan."""
    folder = tmp_path_factory.mktemp("approached")
    bare = tuple(descriptor for descriptor in omnipush_descriptors() if weight_count(descriptor) == 0)
    simulate_dataset(Simulation(bare[::3], 60, seed=1), folder, quiet=True)
    return read_folder(folder)


def test_the_default_plan_moves_objects_as_omnipush_s_were_recorded(approached: Pushes) -> None:
    """Every quantile of distance and turn of 1,440 pushes is within a quarter of the recorded one.

    All pushes of all objects are within 15 % (``benchmarks/omnipush_quantiles.py``). A quantile of this sample has a
    sampling error of 3 to 6 %, at the lowest one 10 %, and so few objects add their own.
    """
    found, recorded = motion_quantiles(approached.rows()[1]), recorded_outcomes()

    assert found.distance_mm == pytest.approx(recorded.distance_mm, rel=0.25)
    assert found.turn_deg == pytest.approx(recorded.turn_deg, rel=0.25)
    assert 0.10 < found.still_share < 0.18


def test_the_default_plan_has_starts_and_directions_spread_about_as_published(approached: Pushes) -> None:
    """Deviations of starts and directions are within 15 % of Omnipush's."""
    figures = compare_statistics(*approached.rows(), published_normalisation())

    assert [figure.ratio for figure in figures[:3]] == pytest.approx([1.0] * 3, abs=0.15)
