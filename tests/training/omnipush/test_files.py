"""Which files belong to which object, and in which variant."""

import os
from pathlib import Path

import numpy as np
import pytest

from service.errors import DataError
from training.omnipush.files import (
    MAX_FILE_BYTES,
    FilePair,
    Variant,
    check_lengths,
    holds_pushes,
    list_folder,
    read_content,
    read_pair,
    write_pair,
)

FIRST, SECOND = "1a2b3c4a", "2B3a3a4a"
ROWS = np.arange(12.0).reshape(4, 3)


def test_names_end_as_published() -> None:
    """Raw and normalised, pusher and outcome."""
    suffixes = [(variant.pusher_suffix, variant.outcome_suffix) for variant in Variant]

    assert suffixes == [("_X_3_not_norm.npy", "_y_3_not_norm.npy"), ("_X_3_norm.npy", "_y_3_norm.npy")]


def test_raw_pairs_come_before_normalised_ones(tmp_path: Path) -> None:
    """The normalised pair is a twin where both are there, and the pair to read where it is alone."""
    write_pair(tmp_path, SECOND, Variant.NORMALISED, ROWS, ROWS)
    for variant in Variant:
        write_pair(tmp_path, FIRST, variant, ROWS, ROWS)

    found = list_folder(tmp_path)
    assert {name: pair.variant for name, pair in found.pairs.items()} == {
        FIRST: Variant.RAW,
        SECOND: Variant.NORMALISED,
    }
    assert found.twins == {
        FIRST: FilePair(
            FIRST, Variant.NORMALISED, tmp_path / (FIRST + "_X_3_norm.npy"), tmp_path / (FIRST + "_y_3_norm.npy")
        )
    }
    assert (found.faults, found.warnings) == ((), ())


@pytest.mark.parametrize("variant", Variant)
@pytest.mark.parametrize("half", ["X", "y"])
def test_half_an_object_is_a_fault(tmp_path: Path, variant: Variant, half: str) -> None:
    """Either file alone; the message names the one to fetch."""
    write_pair(tmp_path, FIRST, variant, ROWS, ROWS)
    gone = tmp_path / (FIRST + {"X": variant.pusher_suffix, "y": variant.outcome_suffix}[half])
    gone.unlink()

    found = list_folder(tmp_path)
    assert found.pairs == {}
    assert [str(fault) for fault in found.faults] == [
        f"{gone} is missing beside {next(tmp_path.iterdir()).name}; fetch or simulate this object again"
    ]


def test_half_a_twin_is_a_warning(tmp_path: Path) -> None:
    """Nobody needs it: the raw pair is whole."""
    for variant in Variant:
        write_pair(tmp_path, FIRST, variant, ROWS, ROWS)
    (tmp_path / (FIRST + "_y_3_norm.npy")).unlink()

    found = list_folder(tmp_path)
    assert (list(found.pairs), found.twins, found.faults) == ([FIRST], {}, ())
    assert "y_3_norm.npy is missing beside" in found.warnings[0]


def test_half_a_raw_pair_is_not_made_up_for(tmp_path: Path) -> None:
    """A copy that broke off is refused, even if the normalised variant is whole."""
    for variant in Variant:
        write_pair(tmp_path, FIRST, variant, ROWS, ROWS)
    (tmp_path / (FIRST + "_y_3_not_norm.npy")).unlink()

    found = list_folder(tmp_path)
    assert found.pairs == {}
    assert len(found.faults) == 1


def test_every_fault_is_listed(tmp_path: Path) -> None:
    """Not only the first: an inspection tells all."""
    for name in ("9z2b3c4a", "1B2b3c4a", FIRST, FIRST + "_again"):
        write_pair(tmp_path, name, Variant.RAW, ROWS, ROWS)

    faults = [str(fault) for fault in list_folder(tmp_path).faults]
    assert len(faults) == 6
    assert sum("8-character descriptor" in fault for fault in faults) == 2
    assert sum("on shape 1" in fault for fault in faults) == 2
    assert sum("are the same object; keep one of them" in fault for fault in faults) == 2


def test_other_files_are_left_alone(tmp_path: Path) -> None:
    """Views, parts, hidden files, folders and pipes are no pushes; a pipe must not be waited for."""
    (tmp_path / f"._{FIRST}_X_3_not_norm.npy").touch()
    np.save(tmp_path / f"shape_{FIRST}.npy", ROWS)
    (tmp_path / f".{FIRST}_X_3_not_norm.npy.part").touch()
    (tmp_path / f"{FIRST}_X_3_not_norm.npy").mkdir()
    os.mkfifo(tmp_path / f"{FIRST}_y_3_not_norm.npy")

    assert not holds_pushes(tmp_path)
    assert list_folder(tmp_path).pairs == {}


def test_a_folder_that_cannot_be_listed_is_named(tmp_path: Path) -> None:
    """A file in its place, for one."""
    (tmp_path / "file").touch()

    with pytest.raises(DataError, match=r"file cannot be listed \(Not a directory\)"):
        list_folder(tmp_path / "file")


def test_a_huge_file_is_refused_before_it_is_read(tmp_path: Path) -> None:
    """A sparse file of more than any object could need."""
    path = tmp_path / "huge.npy"
    with path.open("wb") as file:
        file.truncate(MAX_FILE_BYTES + 1)

    with pytest.raises(DataError, match=f"has {MAX_FILE_BYTES + 1} bytes") as caught:
        read_content(path)
    assert str(path) in str(caught.value)


def test_a_file_that_is_gone_is_named(tmp_path: Path) -> None:
    """It may vanish between listing and reading."""
    with pytest.raises(DataError, match=r"gone\.npy cannot be read \(No such file or directory\)"):
        read_content(tmp_path / "gone.npy")


def test_a_pair_comes_in_the_precision_of_its_files(tmp_path: Path) -> None:
    """Whoever asks what a file holds is told."""
    pair = FilePair(FIRST, Variant.RAW, tmp_path / "X.npy", tmp_path / "y.npy")
    np.save(pair.pusher, ROWS.astype(np.float32))
    np.save(pair.outcome, ROWS)

    assert [array.dtype for array in read_pair(pair)] == [np.float32, np.float64]


def test_both_files_must_have_as_many_rows(tmp_path: Path) -> None:
    """The message names the file and both numbers."""
    pair = FilePair(FIRST, Variant.RAW, tmp_path / "X.npy", tmp_path / "y.npy")

    check_lengths(pair, ROWS, ROWS)
    with pytest.raises(DataError, match=r"y\.npy has 3 rows and X\.npy has 4"):
        check_lengths(pair, ROWS, ROWS[:3])


@pytest.mark.parametrize("blocked", ["a folder", "its parent"])
def test_what_cannot_be_written_is_named(tmp_path: Path, blocked: str) -> None:
    """A file stands where the folder should be: nobody can write there, not even root."""
    (tmp_path / "file").touch()
    folder = tmp_path / "file" if blocked == "a folder" else tmp_path / "file" / "below"

    with pytest.raises(DataError, match=r"_X_3_not_norm\.npy cannot be written \(Not a directory\); .* another folder"):
        write_pair(folder, FIRST, Variant.RAW, ROWS, ROWS)
