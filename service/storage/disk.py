"""File access for registries and results: bounded reads, synced writes, and files that are written whole or not at all.

Functions raise ``OSError`` if the disk refuses. Two exceptions: ``read_plain`` raises ``BrokenModelError``, because it
reads files that others wrote, and ``new_file`` raises ``DataError``, because a person chose its path.
"""

import errno
import fcntl
import os
import secrets
import shutil
import stat
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Final

from service.errors import BrokenModelError, DataError

LOCK_PATIENCE_S: Final = 60.0
MAX_SHOWN: Final = 120  # characters of a file's name in messages
_FILE: Final = os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC


def lock(path: Path) -> int:
    """Open a file for one exclusive writer and return its descriptor.

    Waits up to ``LOCK_PATIENCE_S`` seconds for another writer. The lock ends with the process, however that ends.
    """
    descriptor = os.open(path, os.O_RDWR | os.O_APPEND | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC, 0o644)
    try:
        _check_plain(descriptor, path.name)
        end = time.monotonic() + LOCK_PATIENCE_S
        while True:
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                if time.monotonic() > end:
                    raise
                time.sleep(0.01)
            else:
                return descriptor
    except BaseException:
        os.close(descriptor)
        raise


def read_plain(folder: int, file: str, limit: int) -> bytes:
    """Read a plain file of an open folder. Its size is checked before it is read.

    Raises:
        BrokenModelError: the file is missing, is not a plain file, or has more than ``limit`` bytes.
    """
    with _plain(folder, file) as descriptor, os.fdopen(descriptor, "rb", closefd=False) as opened:
        content = b"" if os.fstat(descriptor).st_size > limit else opened.read(limit + 1)
        too_large = len(content) > limit or os.fstat(descriptor).st_size > limit
    if too_large:
        raise BrokenModelError(f"{file}: more than {limit} bytes")
    return content


def check_plain(folder: int, file: str) -> None:
    """Check that a file of an open folder is plain and may be read. No byte is read.

    Raises:
        BrokenModelError: it is missing, is not a plain file, or may not be read.
    """
    with _plain(folder, file):
        pass


@contextmanager
def _plain(folder: int, file: str) -> Iterator[int]:
    """Open a plain file of an open folder for reading. Errors of the disk name the file."""
    try:
        descriptor = os.open(file, _FILE, dir_fd=folder)
        try:
            _check_plain(descriptor, file)
            yield descriptor
        finally:
            os.close(descriptor)
    except OSError as error:
        known = {errno.ELOOP: "a link; links are not followed", errno.ENXIO: "not a regular file"}  # ENXIO: a socket
        raise BrokenModelError(f"{file}: {known.get(error.errno or 0, reason(error))}") from error


def _check_plain(descriptor: int, file: str) -> None:
    """Refuse folders, pipes and devices, and files with a second name, under which they could be changed."""
    kind = os.fstat(descriptor)
    if not stat.S_ISREG(kind.st_mode):
        raise BrokenModelError(f"{file}: not a regular file")
    if kind.st_nlink > 1:
        raise BrokenModelError(f"{file}: a hard link, so it could be changed under another name; replace it by a copy")


def reason(error: OSError) -> str:
    """Return the operating system's message without the path."""
    return error.strerror or "the disk refused"


def legible(name: str) -> str:
    """Return a file's name as text of one line. Unprintable characters are escaped, and a long name is cut."""
    shown = name[:MAX_SHOWN] + ("..." if len(name) > MAX_SHOWN else "")
    return "".join(char if char.isprintable() else ascii(char)[1:-1] for char in shown)


def must_be_folder(path: Path) -> None:
    """Raise ``OSError`` unless the path is a folder. A link to a folder is refused too."""
    os.close(os.open(path, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC))


def discard(path: Path) -> None:
    """Delete a file or a folder with its content. Links are not followed."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def write_synced(path: Path, content: bytes) -> None:
    """Create a file and return once its bytes are on the disk."""
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o644)
    try:
        write_all(descriptor, content)
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def write_all(descriptor: int, content: bytes) -> None:
    """Write all bytes, in as many calls as the system needs."""
    while content:
        content = content[os.write(descriptor, content) :]


def sync(folder: Path) -> None:
    """Put the names in a folder on the disk."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def replace_whole(path: Path, content: bytes) -> None:
    """Create or replace a file as a whole: a reader, or a crash, sees the old content or the new, never a part.

    The bytes are written and synced under a hidden name in the same folder, which is then renamed and synced.
    """
    part = _part_of(path)
    try:
        write_synced(part, content)
        part.replace(path)
        sync(path.parent)
    finally:
        part.unlink(missing_ok=True)


@contextmanager
def new_file(path: Path) -> Iterator[IO[bytes]]:
    """Open a new file for writing. It gets its name when the block succeeds and is deleted when the block fails.

    An existing file is never replaced.

    Raises:
        DataError: the name is taken, or the disk refuses.
    """
    if os.path.lexists(path):
        raise _taken(path)
    part = _part_of(path)
    try:
        with part.open("xb") as opened:
            yield opened
            opened.flush()
            os.fsync(opened.fileno())
        _give_name(part, path)
    except OSError as error:
        raise DataError(f"{path}: cannot be written: {error.strerror or error}") from error
    finally:
        part.unlink(missing_ok=True)


def _part_of(path: Path) -> Path:
    """Return a fresh hidden name beside a file, on the same disk, so that a rename can follow."""
    return path.with_name(f".{path.name}.{secrets.token_hex(4)}.part")


def _give_name(part: Path, path: Path) -> None:
    """Name a finished file by a link. Unlike a rename, a link cannot replace a file that appeared in the meantime."""
    try:
        path.hardlink_to(part)
    except FileExistsError as error:
        raise _taken(path) from error
    except OSError as error:  # a file system without hard links
        if os.path.lexists(path):
            raise _taken(path) from error
        part.replace(path)


def _taken(path: Path) -> DataError:
    return DataError(f"{path}: received a name that is taken; accepted is a new one: remove that file or name another")
