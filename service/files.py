"""Reading of files that a person names, such as settings, keys and recipes: regular ones, up to a size.

A pipe would hang its reader, a device may have no end, and an editor on Windows puts a byte order mark in front.
Every fault is an ``OSError`` with the path and the reason, as if the system had refused.
"""

import codecs
import errno
import os
import stat
from pathlib import Path
from typing import Final

SMALL_FILE: Final = 1 << 20  # bytes of the largest file of settings, keys or a recipe


def read_file(path: Path, largest: int = SMALL_FILE) -> bytes:
    """Read a regular file of at most ``largest`` bytes.

    Raises:
        OSError: the file is missing, is a folder, pipe or device, has to be waited for, or is too large.
    """
    check_regular(path, path.stat().st_mode)  # before it is opened, which alone changes some devices
    with open(os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC), "rb") as opened:  # noqa: PTH123 (a descriptor)
        check_regular(path, os.fstat(opened.fileno()).st_mode)
        content: bytes | None = opened.read(largest + 1)
    if content is None:  # as some files of /proc, which wait for their content
        raise BlockingIOError(errno.EAGAIN, "no content that can be read at once", str(path))
    if len(content) > largest:
        raise OSError(errno.EFBIG, f"more than {largest} bytes", str(path))
    return content


def read_text(path: Path, largest: int = SMALL_FILE) -> str:
    """Read a regular file in UTF-8. A byte order mark is skipped.

    Raises:
        OSError: see ``read_file``. The content is not UTF-8.
    """
    try:
        return without_mark(read_file(path, largest)).decode()
    except UnicodeDecodeError as error:
        raise OSError(errno.EILSEQ, f"not text in UTF-8 at byte {error.start}", str(path)) from error


def without_mark(content: bytes) -> bytes:
    """Return the content of a file without a byte order mark in front."""
    return content.removeprefix(codecs.BOM_UTF8)


def check_regular(path: Path, mode: int) -> None:
    """Refuse folders, pipes, sockets and devices by the mode of a file.

    Raises:
        OSError: the file is not a regular one.
    """
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(errno.EISDIR, "a folder, not a file", str(path))
    if not stat.S_ISREG(mode):
        raise OSError(errno.EINVAL, "a pipe, socket or device, not a file", str(path))
