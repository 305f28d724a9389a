"""A file that is there whole or not at all, and never instead of another."""

from pathlib import Path

import pytest

from service.bulk.new_file import new_file
from service.errors import DataError


def test_a_file_appears_when_it_is_whole(tmp_path: Path) -> None:
    """Not before, and nothing is left beside it."""
    path = tmp_path / "out"
    with new_file(path) as opened:
        opened.write(b"half")
        assert not path.exists()
        opened.write(b" and half")
    assert path.read_bytes() == b"half and half"
    assert [*tmp_path.iterdir()] == [path]


def test_nothing_is_left_of_what_failed(tmp_path: Path) -> None:
    """However it failed."""
    with pytest.raises(KeyboardInterrupt), new_file(tmp_path / "out"):
        raise KeyboardInterrupt
    assert [*tmp_path.iterdir()] == []


def test_what_came_meanwhile_stays(tmp_path: Path) -> None:
    """Whoever is first has the name."""
    path = tmp_path / "out"
    with pytest.raises(DataError, match="received a name that is taken"), new_file(path):
        path.write_bytes(b"theirs")
    assert path.read_bytes() == b"theirs"
    assert [*tmp_path.iterdir()] == [path]


def test_a_name_that_is_a_dangling_link_is_taken(tmp_path: Path) -> None:
    """Nothing is written through it."""
    (tmp_path / "out").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(DataError, match="received a name that is taken"), new_file(tmp_path / "out"):
        pass
    assert not (tmp_path / "elsewhere").exists()
