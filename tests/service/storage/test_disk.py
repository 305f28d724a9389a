"""Tests of files that are written whole or not at all."""

from pathlib import Path

import pytest

from service.errors import DataError
from service.storage.disk import new_file, replace_whole


def test_new_file_appears_only_when_it_is_complete(tmp_path: Path) -> None:
    """A new file has no name while it is being written, and leaves no temporary file beside it."""
    path = tmp_path / "out"
    with new_file(path) as opened:
        opened.write(b"half")
        assert not path.exists()
        opened.write(b" and half")
    assert path.read_bytes() == b"half and half"
    assert [*tmp_path.iterdir()] == [path]


def test_failed_new_file_leaves_an_empty_folder(tmp_path: Path) -> None:
    """A block that is interrupted leaves neither the file nor a temporary file."""
    with pytest.raises(KeyboardInterrupt), new_file(tmp_path / "out"):
        raise KeyboardInterrupt
    assert [*tmp_path.iterdir()] == []


def test_new_file_keeps_a_file_that_appeared_in_the_meantime(tmp_path: Path) -> None:
    """A file that another process created first keeps its name and its content."""
    path = tmp_path / "out"
    with pytest.raises(DataError, match="received a name that is taken"), new_file(path):
        path.write_bytes(b"theirs")
    assert path.read_bytes() == b"theirs"
    assert [*tmp_path.iterdir()] == [path]


def test_new_file_refuses_the_name_of_a_dangling_link(tmp_path: Path) -> None:
    """A dangling link counts as a taken name, and no file is created at its target."""
    (tmp_path / "out").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(DataError, match="received a name that is taken"), new_file(tmp_path / "out"):
        pass
    assert not (tmp_path / "elsewhere").exists()


def test_replaced_file_is_a_new_file_of_the_same_name(tmp_path: Path) -> None:
    """A reader that holds the old file keeps the old content, and no temporary file is left."""
    path = tmp_path / "out"
    replace_whole(path, b"old")
    with path.open("rb") as opened:
        replace_whole(path, b"new")
        assert opened.read() == b"old"
    assert path.read_bytes() == b"new"
    assert [*tmp_path.iterdir()] == [path]


def test_failed_replacement_leaves_no_temporary_file(tmp_path: Path) -> None:
    """A replacement that the system refuses, here of a folder, changes no entry of the parent folder."""
    path = tmp_path / "out"
    path.mkdir()
    with pytest.raises(IsADirectoryError):
        replace_whole(path, b"new")
    assert [*tmp_path.iterdir()] == [path]
