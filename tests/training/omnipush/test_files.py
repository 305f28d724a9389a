"""Files of pushes: the match of files to objects and variants, and faults."""

import os
from pathlib import Path

import numpy as np
import pytest

from service.errors import DataError
from training.omnipush.files import FilePair, Variant, check_lengths, holds_pushes, list_folder, read_pair, write_pair

FIRST, SECOND = "1a2b3c4a", "2B3a3a4a"
ROWS = np.arange(12.0).reshape(4, 3)


def test_file_names_have_the_published_suffixes() -> None:
    """Pusher and outcome files of both variants have the suffixes of the release."""
    suffixes = [(variant.pusher_suffix, variant.outcome_suffix) for variant in Variant]

    assert suffixes == [("_X_3_not_norm.npy", "_y_3_not_norm.npy"), ("_X_3_norm.npy", "_y_3_norm.npy")]


def test_raw_pairs_are_preferred_to_normalised_ones(tmp_path: Path) -> None:
    """A normalised pair is a twin if the object also has a raw pair, and the pair to read if it has none."""
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
def test_half_a_pair_is_a_fault(tmp_path: Path, variant: Variant, half: str) -> None:
    """An object with only one of its two files is a fault, whose message names the missing file."""
    write_pair(tmp_path, FIRST, variant, ROWS, ROWS)
    gone = tmp_path / (FIRST + {"X": variant.pusher_suffix, "y": variant.outcome_suffix}[half])
    gone.unlink()

    found = list_folder(tmp_path)
    assert found.pairs == {}
    assert [str(fault) for fault in found.faults] == [
        f"{gone} is missing beside {next(tmp_path.iterdir()).name}; fetch or simulate this object again"
    ]


def test_half_a_twin_is_a_warning(tmp_path: Path) -> None:
    """Half a normalised pair is a warning if the raw pair is complete, because readers use the raw pair."""
    for variant in Variant:
        write_pair(tmp_path, FIRST, variant, ROWS, ROWS)
    (tmp_path / (FIRST + "_y_3_norm.npy")).unlink()

    found = list_folder(tmp_path)
    assert (list(found.pairs), found.twins, found.faults) == ([FIRST], {}, ())
    assert "y_3_norm.npy is missing beside" in found.warnings[0]


def test_a_normalised_pair_does_not_replace_half_a_raw_pair(tmp_path: Path) -> None:
    """Half a raw pair is refused even if the normalised pair is complete, because the copy broke off."""
    for variant in Variant:
        write_pair(tmp_path, FIRST, variant, ROWS, ROWS)
    (tmp_path / (FIRST + "_y_3_not_norm.npy")).unlink()

    found = list_folder(tmp_path)
    assert found.pairs == {}
    assert len(found.faults) == 1


def test_every_fault_is_listed(tmp_path: Path) -> None:
    """A listing holds every fault of a folder, not only the first."""
    for name in ("9z2b3c4a", "1B2b3c4a", FIRST, FIRST + "_again"):
        write_pair(tmp_path, name, Variant.RAW, ROWS, ROWS)

    faults = [str(fault) for fault in list_folder(tmp_path).faults]
    assert len(faults) == 6
    assert sum("8-character descriptor" in fault for fault in faults) == 2
    assert sum("on shape 1" in fault for fault in faults) == 2
    assert sum("are the same object; keep one of them" in fault for fault in faults) == 2


def test_other_files_are_ignored(tmp_path: Path) -> None:
    """Views, part files, hidden files, folders and pipes are not files of pushes, and a pipe is not waited for."""
    (tmp_path / f"._{FIRST}_X_3_not_norm.npy").touch()
    np.save(tmp_path / f"shape_{FIRST}.npy", ROWS)
    (tmp_path / f".{FIRST}_X_3_not_norm.npy.part").touch()
    (tmp_path / f"{FIRST}_X_3_not_norm.npy").mkdir()
    os.mkfifo(tmp_path / f"{FIRST}_y_3_not_norm.npy")

    assert not holds_pushes(tmp_path)
    assert list_folder(tmp_path).pairs == {}


def test_a_folder_that_cannot_be_listed_is_named(tmp_path: Path) -> None:
    """The error about a folder that cannot be listed names it and the system's reason."""
    (tmp_path / "file").touch()

    with pytest.raises(DataError, match=r"file cannot be listed \(Not a directory\)"):
        list_folder(tmp_path / "file")


def test_a_pair_is_read_in_the_precision_of_its_files(tmp_path: Path) -> None:
    """Arrays keep the data type of their files, so that an inspection can report it."""
    pair = FilePair(FIRST, Variant.RAW, tmp_path / "X.npy", tmp_path / "y.npy")
    np.save(pair.pusher, ROWS.astype(np.float32))
    np.save(pair.outcome, ROWS)

    assert [array.dtype for array in read_pair(pair)] == [np.float32, np.float64]


def test_both_files_must_have_as_many_rows(tmp_path: Path) -> None:
    """The error about files of different length names the file and both numbers of rows."""
    pair = FilePair(FIRST, Variant.RAW, tmp_path / "X.npy", tmp_path / "y.npy")

    check_lengths(pair, ROWS, ROWS)
    with pytest.raises(DataError, match=r"y\.npy has 3 rows and X\.npy has 4"):
        check_lengths(pair, ROWS, ROWS[:3])


@pytest.mark.parametrize("blocked", ["a folder", "its parent"])
def test_a_file_that_cannot_be_written_is_named(tmp_path: Path, blocked: str) -> None:
    """The error about a blocked folder names the file; a file in the folder's place stops even root."""
    (tmp_path / "file").touch()
    folder = tmp_path / "file" if blocked == "a folder" else tmp_path / "file" / "below"

    with pytest.raises(DataError, match=r"_X_3_not_norm\.npy cannot be written \(Not a directory\); .* another folder"):
        write_pair(folder, FIRST, Variant.RAW, ROWS, ROWS)
