"""How a copy of Omnipush is laid out: a folder per surface, and the top-down views in a folder of their own.

The published tree (``ftp://omnipush.mit.edu/omnipush/``), whose names are met as they are::

    meta-learning_data/0,1,2_weights/   pushes on ABS, 250 objects
    meta-learning_data/plywood/         pushes on plywood, 10 objects
    top-down_view/{0,1,2}_weight/       shape_<descriptor>.npy, 481 x 481

This project writes ``abs/``, ``plywood/`` and ``top-down_view/`` side by side. A reader is given a surface's folder or
one above it.
"""

from enum import StrEnum
from pathlib import Path
from typing import Final

from service.errors import DataError
from training.omnipush.files import holds_pushes

_DEPTH: Final = 2  # folders between the one named and the pushes: meta-learning_data/plywood


class SurfaceKind(StrEnum):
    """What the objects lie on."""

    ABS = "abs"
    PLYWOOD = "plywood"


def surface_folders(folder: Path) -> list[Path]:
    """The folder itself, or else those nearest below it, that hold pushes; sorted.

    Raises:
        DataError: a folder cannot be listed.
    """
    level = [folder]
    for _ in range(_DEPTH + 1):
        found = [path for path in level if holds_pushes(path)]
        if found:
            return found
        level = [below for path in level for below in _folders(path)]
    return []


def surface_kind(folder: Path) -> SurfaceKind:
    """Plywood where the folder's name says so; everything else is ABS, as the release's main folder is."""
    return SurfaceKind.PLYWOOD if SurfaceKind.PLYWOOD in folder.resolve().name.lower() else SurfaceKind.ABS


def view_places(folder: Path, surfaces: list[Path]) -> set[Path]:
    """Where the folder of top-down views may stand: in the folder named or a surface's, or beside them."""
    inside = {folder.resolve(), *(path.resolve() for path in surfaces)}
    return inside | {path.parent for path in inside} | {path.parent.parent for path in inside - {folder.resolve()}}


def _folders(folder: Path) -> list[Path]:
    try:
        return sorted(path for path in folder.iterdir() if path.is_dir() and not path.name.startswith("."))
    except OSError as error:
        raise DataError(
            f"{folder} cannot be listed ({error.strerror}); mend its permissions or name another folder"
        ) from error
