"""Folder layout of a copy of Omnipush: a folder per surface, and a folder of top-down views.

The published tree (``ftp://omnipush.mit.edu/omnipush/``), whose names are accepted unchanged::

    meta-learning_data/0,1,2_weights/   pushes on ABS, 250 objects
    meta-learning_data/plywood/         pushes on plywood, 10 objects
    top-down_view/{0,1,2}_weight/       shape_<descriptor>.npy, 481 x 481

This project writes ``abs/``, ``plywood/`` and ``top-down_view/`` side by side. A reader is given the folder of one
surface or a folder above it.
"""

from enum import StrEnum
from pathlib import Path
from typing import Final

from service.errors import DataError
from training.omnipush.files import holds_pushes

SIMULATED: Final = Path("data/approach")  # of the default plan of training.simulation.plans
DEFAULT_DATA: Final = SIMULATED / "abs"
_DEPTH: Final = 2  # levels below the folder named that are searched: meta-learning_data/plywood


class SurfaceKind(StrEnum):
    """Material of the surface under the objects."""

    ABS = "abs"
    PLYWOOD = "plywood"


def surface_folders(folder: Path) -> list[Path]:
    """Find the folders of pushes: the folder itself, or else the nearest ones below it, sorted.

    Raises:
        DataError: A folder cannot be listed.
    """
    level = [folder]
    for _ in range(_DEPTH + 1):
        found = [path for path in level if holds_pushes(path)]
        if found:
            return found
        level = [below for path in level for below in _folders(path)]
    return []


def surface_kind(folder: Path) -> SurfaceKind:
    """Return plywood if the folder's name contains it, otherwise ABS, the surface of the release's main folder."""
    return SurfaceKind.PLYWOOD if SurfaceKind.PLYWOOD in folder.resolve().name.lower() else SurfaceKind.ABS


def view_places(folder: Path, surfaces: list[Path]) -> set[Path]:
    """Return the folders that may contain the folder of views: those named, those of surfaces, and their parents."""
    inside = {folder.resolve(), *(path.resolve() for path in surfaces)}
    return inside | {path.parent for path in inside} | {path.parent.parent for path in inside - {folder.resolve()}}


def data_options(folder: Path, views: Path | None) -> str:
    """Render the command-line options that name a folder of pushes and its views, without the default ones."""
    return ("" if folder == DEFAULT_DATA else f" --data {folder}") + ("" if views is None else f" --views {views}")


def _folders(folder: Path) -> list[Path]:
    try:
        return sorted(path for path in folder.iterdir() if path.is_dir() and not path.name.startswith("."))
    except OSError as error:
        raise DataError(
            f"{folder} cannot be listed ({error.strerror}); check its permissions, or name another folder"
        ) from error
