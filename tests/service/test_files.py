"""Files that a person names: regular ones are read, up to a size, and all others are refused without waiting."""

import os
from pathlib import Path

import pytest

from service.files import SMALL_FILE, read_file, read_text


def test_a_byte_order_mark_is_skipped(tmp_path: Path) -> None:
    """A text file is read in UTF-8, with or without the mark that editors on Windows write."""
    path = tmp_path / "file"
    path.write_bytes("\ufeffport = 1 # ö".encode())
    assert read_text(path) == "port = 1 # ö"
    assert read_text(path, path.stat().st_size) == "port = 1 # ö"


@pytest.mark.parametrize("kind", ["missing", "folder", "pipe", "device", "large", "below a file", "not UTF-8"])
def test_anything_but_a_small_regular_file_is_refused(tmp_path: Path, kind: str) -> None:
    """A folder, a pipe without a writer, a device and a large file are refused with the path and the reason."""
    path = tmp_path / "file"
    match kind:
        case "folder":
            path.mkdir()
        case "pipe":
            os.mkfifo(path)
        case "device":
            path.symlink_to("/dev/zero")
        case "large":
            with path.open("wb") as file:
                file.truncate(SMALL_FILE + 1)
        case "below a file":
            path.touch()
            path /= "below"
        case "not UTF-8":
            path.write_bytes(b"\xff\xfep\0o\0")
    with pytest.raises(OSError, match=r"Errno") as refused:
        read_text(path)
    assert refused.value.filename in (path, str(path))
    assert refused.value.strerror


def test_a_file_without_content_to_read_at_once_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A file such as /proc/kmsg is a regular one, and has to be waited for."""
    path = tmp_path / "file"
    path.touch()
    reading, writing = os.pipe()
    os.set_blocking(reading, False)
    mode = path.stat()
    with monkeypatch.context() as patch:
        patch.setattr(os, "open", lambda *_: reading)
        patch.setattr(os, "fstat", lambda _: mode)
        with pytest.raises(BlockingIOError, match="at once"):
            read_file(path)
    os.close(writing)


def test_a_file_of_exactly_the_limit_is_read(tmp_path: Path) -> None:
    """The limit counts bytes, and the largest accepted file is read as a whole."""
    path = tmp_path / "file"
    path.write_bytes(b"a" * 16)
    assert read_file(path, 16) == b"a" * 16
    with pytest.raises(OSError, match="more than 15 bytes"):
        read_file(path, 15)
