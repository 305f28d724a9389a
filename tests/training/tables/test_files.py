"""Files of a table: their names, and kinds and sizes that are refused before a byte is read."""

import os
from collections.abc import Callable
from pathlib import Path

import pytest

from service.errors import DataError
from tests.training.tables.tables import write_folder
from training.tables.files import find_files, is_table
from training.tables.reading import read_table


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """The file of pushes of a valid table."""
    return write_folder(tmp_path) / "pushes.csv"


def ten_gigabytes(path: Path) -> None:
    """Make a file of 10 GB that takes no place on the disk."""
    with path.open("ab") as opened:
        opened.truncate(10 << 30)


def pipe(path: Path) -> None:
    """Put a pipe in the place of a file."""
    path.unlink()
    os.mkfifo(path)


def folder(path: Path) -> None:
    """Put a folder in the place of a file."""
    path.unlink()
    path.mkdir()


def device(path: Path) -> None:
    """Put a link to an endless device in the place of a file."""
    path.unlink()
    path.symlink_to("/dev/zero")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (ten_gigabytes, "received 10.0 GiB; accepted are up to 2 GiB in one file: split it into several tables"),
        (pipe, "cannot be read (a pipe, socket or device, not a file)"),
        (folder, "cannot be read (a folder, not a file)"),
        (device, "cannot be read (a pipe, socket or device, not a file)"),
    ],
)
def test_a_file_of_another_kind_or_size_is_refused(path: Path, change: Callable[[Path], None], words: str) -> None:
    """Refuse what would hang, never end or not fit, in one line that says what to do."""
    change(path)
    with pytest.raises(DataError) as caught:
        read_table(path.parent)
    assert str(caught.value).startswith(f"{path}: {words}")


def test_two_formats_of_one_table_are_refused(path: Path) -> None:
    """Refuse to guess which of two files counts."""
    path.with_suffix(".parquet").touch()
    with pytest.raises(DataError, match=r"holds pushes\.csv and pushes\.parquet; keep one of them"):
        find_files(path.parent)


def test_a_missing_file_is_named_with_its_names(path: Path) -> None:
    """Name the files that were looked for."""
    (path.parent / "objects.csv").unlink()
    with pytest.raises(DataError, match=r"holds no file of outlines; expected objects\.csv or objects\.parquet"):
        read_table(path)


def test_a_table_is_a_folder_or_a_file_of_any_name(path: Path, tmp_path: Path) -> None:
    """Recognise a table by the name of its pushes, and a file by its ending."""
    assert is_table(path.parent)
    renamed = path.rename(path.with_name("monday.CSV"))
    assert is_table(renamed)
    objects = (path.parent / "objects.csv").rename(tmp_path / "boxes.csv")
    assert read_table(renamed, objects).count == 1


def test_a_folder_of_tables_of_other_names_says_how_to_name_them(path: Path) -> None:
    """A folder with a table under another name is meant as one, and a folder of numpy files beside a table is not."""
    path.rename(path.with_name("monday.csv"))
    assert is_table(path.parent)
    with pytest.raises(DataError, match=r"it holds monday\.csv, objects\.csv: rename it, or name it itself"):
        find_files(path.parent)
    (path.parent / "1a1a1a1a_X_3_not_norm.npy").touch()
    assert not is_table(path.parent)
    with pytest.raises(DataError, match="does not exist; name a folder with"):
        find_files(path.parent / "nowhere")
