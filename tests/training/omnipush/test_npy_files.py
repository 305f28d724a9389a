"""``.npy`` files: bounded size, no pickles, whole or absent."""

import pickle
from pathlib import Path

import numpy as np
import pytest

from service.errors import DataError
from tests.training.pickle_trap import PickleTrap
from training.omnipush.npy_files import NpyKind, parse_npy, read_content, write_npy, writing

KIND = NpyKind(1000, "100 numbers", "fetch it again")


def test_an_array_is_read_as_it_was_written(tmp_path: Path) -> None:
    """An array survives a round trip with its shape and type, and the folder holds no other file."""
    array = np.arange(6, dtype=np.int16).reshape(2, 3)
    write_npy(tmp_path / "a.npy", array)
    found = parse_npy(tmp_path / "a.npy", read_content(tmp_path / "a.npy", KIND), KIND)

    assert (found.dtype, found.tolist()) == (array.dtype, array.tolist())
    assert [path.name for path in tmp_path.iterdir()] == ["a.npy"]


def test_a_file_of_the_largest_size_is_read(tmp_path: Path) -> None:
    """The size limit is inclusive."""
    (tmp_path / "a.npy").write_bytes(bytes(KIND.max_bytes))

    assert len(read_content(tmp_path / "a.npy", KIND)) == KIND.max_bytes


def test_a_huge_file_is_refused_before_it_is_read(tmp_path: Path) -> None:
    """The error about a file over the limit names it, its size, the limit and the remedy."""
    path = tmp_path / "huge.npy"
    with path.open("wb") as file:
        file.truncate(2**40)

    with pytest.raises(DataError) as caught:
        read_content(path, KIND)
    assert str(caught.value) == (f"{path} has {2**40} bytes; at most 1000 are accepted (100 numbers); fetch it again")


def test_a_file_that_is_gone_is_named(tmp_path: Path) -> None:
    """The error about a file that vanished after it was listed names it and the system's reason."""
    with pytest.raises(DataError, match=r"gone\.npy cannot be read \(No such file or directory\)"):
        read_content(tmp_path / "gone.npy", KIND)


def test_an_archive_is_not_an_array(tmp_path: Path) -> None:
    """A .npz archive, which numpy would open, is refused by name."""
    np.savez(tmp_path / "a.npz", np.zeros(3))

    with pytest.raises(DataError, match=r"a\.npz is an archive of arrays; expected a \.npy file of one array"):
        parse_npy(tmp_path / "a.npz", (tmp_path / "a.npz").read_bytes(), KIND)


@pytest.mark.parametrize("wrapped", [True, False], ids=["inside an npy", "bare"])
def test_a_pickle_is_not_loaded(tmp_path: Path, wrapped: bool) -> None:
    """A file with a pickle is refused like any broken file, and the code in the pickle does not run."""
    path, trap = tmp_path / "a.npy", PickleTrap(tmp_path / "sprung")
    if wrapped:
        np.save(path, np.array([trap], dtype=object), allow_pickle=True)
    else:
        path.write_bytes(pickle.dumps(trap))

    with pytest.raises(DataError, match=r"a\.npy is not a complete \.npy file of numbers; fetch it again"):
        parse_npy(path, read_content(path, KIND), KIND)
    assert not (tmp_path / "sprung").exists()


def test_a_refusal_of_the_system_names_the_path(tmp_path: Path) -> None:
    """An error of the system inside ``writing`` becomes a data error with path, reason and remedy."""
    with pytest.raises(DataError) as caught, writing(tmp_path / "views"):
        (tmp_path / "nowhere" / "file").write_bytes(b"")
    assert str(caught.value) == (
        f"{tmp_path / 'views'} cannot be written (No such file or directory); fix that or name another folder"
    )


def test_a_trap_of_these_tests_springs_when_it_is_loaded(tmp_path: Path) -> None:
    """A trap makes its folder if numpy loads it as a pickle, so the tests above can fail."""
    np.save(tmp_path / "trap.npy", np.array([PickleTrap(tmp_path / "sprung")]), allow_pickle=True)
    np.load(tmp_path / "trap.npy", allow_pickle=True)
    assert (tmp_path / "sprung").exists()
