"""Read and write ``.npy`` files of pushes and views.

The files may come from other people. A reader bounds the size before it reads, never loads a pickle, and names the file
in every error. A writer leaves the whole file or no file.
"""

import io
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from service.errors import DataError
from service.files import read_file
from service.storage.disk import replace_whole

AnyArray = npt.NDArray[Any]


@dataclass(frozen=True)
class NpyKind:
    """Size limit of a kind of ``.npy`` file, and the advice in its errors."""

    max_bytes: int
    usual_size: str  # for the error about a file that is too large
    remedy: str  # the way to get an intact file


def read_content(path: Path, kind: NpyKind) -> bytes:
    """Return the bytes of a file of at most ``kind.max_bytes``.

    Raises:
        DataError: The file cannot be read or is too large.
    """
    try:
        size = path.stat().st_size
        if size <= kind.max_bytes:
            return read_file(path, kind.max_bytes)
    except OSError as error:
        raise DataError(f"{path} cannot be read ({error.strerror}); check its permissions, or {kind.remedy}") from error
    raise DataError(
        f"{path} has {size} bytes; at most {kind.max_bytes} are accepted ({kind.usual_size}); {kind.remedy}"
    )


def parse_npy(path: Path, content: bytes, kind: NpyKind) -> AnyArray:
    """Return the array in the content of a ``.npy`` file, of any shape and type. Pickles are never loaded.

    Raises:
        DataError: The content is not one complete array.
    """
    try:
        array = np.load(io.BytesIO(content), allow_pickle=False)
    except Exception as error:  # numpy's header parser raises many types of error, and documents no complete list
        raise DataError(f"{path} is not a complete .npy file of numbers; {kind.remedy}") from error
    if not isinstance(array, np.ndarray):
        raise DataError(f"{path} is an archive of arrays; expected a .npy file of one array; {kind.remedy}")
    return array


def write_npy(path: Path, array: AnyArray) -> None:
    """Write one array as a ``.npy`` file, whole or not at all.

    Raises:
        DataError: The file cannot be written.
    """
    buffer = io.BytesIO()
    np.save(buffer, array, allow_pickle=False)
    write_whole(path, buffer.getvalue())


def write_whole(path: Path, content: bytes) -> None:
    """Write a synced file, whole or not at all. Several processes may write the same file.

    Raises:
        DataError: The file cannot be written.
    """
    with writing(path):
        replace_whole(path, content)


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Translate an ``OSError`` of the block into a ``DataError`` that names the path.

    Raises:
        DataError: The system refused to write.
    """
    try:
        yield
    except OSError as error:
        raise DataError(f"{path} cannot be written ({error.strerror}); fix that or name another folder") from error
