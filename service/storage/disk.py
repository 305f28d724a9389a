"""What a registry asks of a disk: plain files read within bounds, bytes that are on the disk when they are said to be.

Every function raises ``OSError`` where the disk refuses; ``read_plain`` alone says ``BrokenModelError``, since it is
asked for what others wrote.
"""

import fcntl
import os
import secrets
import shutil
import stat
import time
from pathlib import Path
from typing import Final

from service.errors import BrokenModelError

LOCK_PATIENCE_S: Final = 60.0
_FILE: Final = os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC


def lock(path: Path) -> int:
    """The history, open for one writer alone; the lock goes with the process, however it ends."""
    descriptor = os.open(path, os.O_RDWR | os.O_APPEND | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC, 0o644)
    try:
        _must_be_plain(descriptor, path.name)
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
    """A plain file of an open folder, of at most ``limit`` bytes; its size is looked at before it is read."""
    try:
        descriptor = os.open(file, _FILE, dir_fd=folder)
        try:
            _must_be_plain(descriptor, file)
            with os.fdopen(descriptor, "rb", closefd=False) as opened:
                content = b"" if os.fstat(descriptor).st_size > limit else opened.read(limit + 1)
                too_large = len(content) > limit or os.fstat(descriptor).st_size > limit
        finally:
            os.close(descriptor)
    except OSError as error:
        raise BrokenModelError(f"{file}: {reason(error)}") from error
    if too_large:
        raise BrokenModelError(f"{file}: more than {limit} bytes")
    return content


def _must_be_plain(descriptor: int, file: str) -> None:
    kind = os.fstat(descriptor)
    if not stat.S_ISREG(kind.st_mode):
        raise BrokenModelError(f"{file}: not a regular file")
    if kind.st_nlink > 1:
        raise BrokenModelError(f"{file}: a hard link: it could be changed under another name")


def reason(error: OSError) -> str:
    """What the disk said."""
    return error.strerror or "the disk refused"


def must_be_folder(path: Path) -> None:
    """Raise where a path is a link, however good the folder behind it."""
    os.close(os.open(path, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC))


def discard(path: Path) -> None:
    """Delete a file or a whole folder; links are not followed."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def write_synced(path: Path, content: bytes) -> None:
    """Create a file whose bytes are on the disk when this returns."""
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o644)
    try:
        write_all(descriptor, content)
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def replace_whole(path: Path, content: bytes) -> None:
    """Create or replace a file as a whole: a reader, or a crash, sees the old content or the new, never a part.

    The bytes are written and synced under a hidden name in the same folder, which is then renamed and synced.
    """
    part = path.with_name(f".{path.name}.{secrets.token_hex(4)}.part")
    try:
        write_synced(part, content)
        part.replace(path)
        sync(path.parent)
    finally:
        part.unlink(missing_ok=True)


def write_all(descriptor: int, content: bytes) -> None:
    """Write every byte."""
    while content:
        content = content[os.write(descriptor, content) :]


def sync(folder: Path) -> None:
    """Put the names in a folder on the disk."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
