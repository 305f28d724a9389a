"""A round trip through the published variants gives the same pushes."""

from pathlib import Path

import numpy as np
import pytest

from service.errors import DataError
from tests.training.copies import SOURCE, plausible_pushes, write_surface
from training.omnipush.declaration import DATASET_FILE, UNKNOWN_SOURCE
from training.omnipush.files import Variant, list_folder
from training.omnipush.published import omnipush_descriptors
from training.omnipush.pushes import export_variants, read_folder, write_object
from training.simulation.dataset import SimulationPlan, simulate_dataset

FLOAT32_STEP = 2.0**-23  # relative distance of neighbouring float32 numbers


@pytest.fixture(scope="module")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A few simulated pushes of three objects."""
    folder = tmp_path_factory.mktemp("simulated") / "abs"
    simulate_dataset(SimulationPlan(omnipush_descriptors()[:3], pushes_per_object=5), folder, threads=1, quiet=True)
    return folder


def only(folder: Path, variant: Variant) -> Path:
    """The folder without the files of the other variant."""
    other = next(each for each in Variant if each is not variant)
    for suffix in (other.pusher_suffix, other.outcome_suffix):
        for path in folder.glob("*" + suffix):
            path.unlink()
    return folder


@pytest.mark.parametrize("kept", [tuple(Variant), (Variant.RAW,)], ids=["both variants", "raw files alone"])
def test_raw_files_give_the_same_tensors_to_the_bit(simulated: Path, tmp_path: Path, kept: tuple[Variant, ...]) -> None:
    """Simulate, export, load: equal arrays and, since the bytes are the same, an equal digest."""
    assert export_variants(simulated, tmp_path / "out", tuple(Variant), quiet=True) == 3
    before, after = (
        read_folder(simulated),
        read_folder(tmp_path / "out" if len(kept) == 2 else only(tmp_path / "out", *kept)),
    )

    assert after.descriptors == before.descriptors
    for name in ("pushers", "outcomes", "valid"):
        assert getattr(after, name).tobytes() == getattr(before, name).tobytes(), name
    assert (after.digest, after.source) == (before.digest, before.source)


def test_normalised_files_give_the_same_tensors_within_rounding(simulated: Path, tmp_path: Path) -> None:
    """The published statistics are applied in float64 and undone in float64: at most one step of float32 apart."""
    export_variants(simulated, tmp_path / "out", tuple(Variant), quiet=True)
    before, after = read_folder(simulated), read_folder(only(tmp_path / "out", Variant.NORMALISED))

    assert after.descriptors == before.descriptors
    assert (after.valid == before.valid).all()
    for name in ("pushers", "outcomes"):
        np.testing.assert_allclose(getattr(after, name), getattr(before, name), rtol=FLOAT32_STEP, atol=1e-15)
    assert after.source == before.source
    assert after.digest != before.digest  # other files were read


def test_the_way_back_from_normalised_files_is_open(simulated: Path, tmp_path: Path) -> None:
    """Whoever has only those can write the raw ones; they agree with the first within rounding."""
    export_variants(simulated, tmp_path / "normalised", (Variant.NORMALISED,), quiet=True)
    export_variants(tmp_path / "normalised", tmp_path / "raw", (Variant.RAW,), quiet=True)

    assert {path.name for path in (tmp_path / "raw").iterdir()} == {path.name for path in simulated.iterdir()}
    np.testing.assert_allclose(
        read_folder(tmp_path / "raw").outcomes, read_folder(simulated).outcomes, rtol=FLOAT32_STEP, atol=1e-15
    )


def test_normalised_files_hold_the_published_transformation(tmp_path: Path) -> None:
    """Less the published mean, divided by the published deviation; the numbers are written out here."""
    pushers, outcomes = plausible_pushes(4, 1)
    write_object(tmp_path, "1a2b3c4a", pushers, outcomes, (Variant.NORMALISED,))

    found = np.load(tmp_path / "1a2b3c4a_X_3_norm.npy"), np.load(tmp_path / "1a2b3c4a_y_3_norm.npy")
    assert found[0][2, 0] == pytest.approx((pushers[2, 0] + 0.0016330612124875188) / 0.05546203628182411)
    assert found[1][3, 2] == pytest.approx((outcomes[3, 2] + 0.002690065884962678) / 0.21515865623950958)
    assert not list(tmp_path.glob("*not_norm*"))


def test_the_label_goes_with_the_pushes(tmp_path: Path) -> None:
    """What was declared stays declared; what was not is called nothing better."""
    write_surface(tmp_path / "abs", ["1a2b3c4a"], rows=2)
    export_variants(tmp_path / "abs", tmp_path / "declared", tuple(Variant), quiet=True)
    (tmp_path / "abs" / DATASET_FILE).unlink()
    export_variants(tmp_path / "abs", tmp_path / "undeclared", tuple(Variant), quiet=True)

    assert read_folder(tmp_path / "declared").source == SOURCE
    assert read_folder(tmp_path / "undeclared").source == UNKNOWN_SOURCE


def test_pushes_of_another_origin_are_not_mixed_in(tmp_path: Path) -> None:
    """Neither into a folder that declares something else, nor into undeclared pushes, nor into itself."""
    write_surface(tmp_path / "abs", ["1a2b3c4a"], rows=2)
    for name in ("bare", "other"):
        (tmp_path / name).mkdir()
        write_object(tmp_path / name, "1a1a1a1a", *plausible_pushes(2, 1))

    with pytest.raises(DataError, match="nothing declares"):
        export_variants(tmp_path / "abs", tmp_path / "bare", tuple(Variant), quiet=True)
    with pytest.raises(DataError, match="already holds pushes"):
        export_variants(tmp_path / "other", tmp_path / "bare", tuple(Variant), quiet=True)
    with pytest.raises(DataError, match="is the folder to export"):
        export_variants(tmp_path / "abs", tmp_path / "abs" / ".." / "abs", tuple(Variant), quiet=True)
    assert len(list_folder(tmp_path / "bare").pairs) == 1


def test_a_broken_folder_is_not_exported(tmp_path: Path) -> None:
    """The fault is named, and nothing is written."""
    write_surface(tmp_path / "abs", ["1a2b3c4a"], rows=2)
    (tmp_path / "abs" / "1a2b3c4a_y_3_not_norm.npy").unlink()

    with pytest.raises(DataError, match="is missing beside"):
        export_variants(tmp_path / "abs", tmp_path / "out", tuple(Variant), quiet=True)
    with pytest.raises(DataError, match="name the folder of one surface"):
        export_variants(tmp_path, tmp_path / "out", tuple(Variant), quiet=True)
    assert not (tmp_path / "out").exists()
