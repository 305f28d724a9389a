"""A file that is there whole or not at all, and that never takes the place of another."""

import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from service.errors import DataError


@contextmanager
def new_file(path: Path) -> Iterator[IO[bytes]]:
    """A file to write, which gets its name when the block ends well and is gone when it does not.

    Raises:
        DataError: something has that name already, or the disk refuses.
    """
    if os.path.lexists(path):
        raise _taken(path)
    part = path.with_name(f".{path.name}.{secrets.token_hex(4)}.part")
    try:
        with part.open("xb") as opened:
            yield opened
            opened.flush()
            os.fsync(opened.fileno())
        _name(part, path)
    except OSError as error:
        raise DataError(f"{path}: cannot be written: {error.strerror or error}") from error
    finally:
        part.unlink(missing_ok=True)


def _name(part: Path, path: Path) -> None:
    """Rename, which unlike a link would replace what came meanwhile."""
    try:
        path.hardlink_to(part)
    except FileExistsError as error:
        raise _taken(path) from error
    except OSError as error:  # a disk without links
        if os.path.lexists(path):
            raise _taken(path) from error
        part.replace(path)


def _taken(path: Path) -> DataError:
    return DataError(f"{path}: received a name that is taken; accepted is a new one: remove that file or name another")
