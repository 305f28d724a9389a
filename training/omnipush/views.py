"""Top-down views of Omnipush objects, read from files of the release or of the simulation.

A folder of views holds ``shape_<descriptor>.npy``, 481 x 481, one grey level per pixel. The release sorts these files
into ``0_weight``, ``1_weight`` and ``2_weight``. Its data type is not published, so any numeric type is read.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from service.errors import DataError, InvalidImageError
from service.pushing.contexts import VISUAL_SIZE
from service.pushing.images import GreyImage, visual_context
from training.omnipush.declaration import read_declared
from training.omnipush.npy_files import NpyKind, parse_npy, read_content

VIEWS_FOLDER: Final = "top-down_view"
VIEW_PREFIX: Final = "shape_"
CAMERA_VIEWS_PREFIX: Final = "cameras_"
VIEW_PIXELS: Final = 481  # odd: the object's centre is the middle of pixel 240
UNKNOWN_CONVENTION: Final = (
    "Top-down views of undeclared origin (481 x 481, as Omnipush publishes them): field of view, orientation and "
    "intensities are not stated with the files; reduced to 32 x 32 as the paper does."
)
UNKNOWN_SOURCE: Final = "top-down views of undeclared origin"
View = npt.NDArray[np.uint8]
_CAMERA_VIEWS: Final = NpyKind(
    1024 * VISUAL_SIZE**2 + 4096, "1,024 views of 32 x 32 bytes", "draw them again with cazsl-train images --views"
)
_VIEW: Final = NpyKind(VIEW_PIXELS**2 * 8 + 4096, "481 x 481 float64", "fetch or draw it again")


def views_beside(folder: Path) -> Path:
    """Return the default folder of views of a surface: the one beside it, as in the release."""
    return folder.parent / VIEWS_FOLDER


def view_file_name(descriptor: str) -> str:
    """Return the name of the file with an object's view."""
    return f"{VIEW_PREFIX}{descriptor}.npy"


def read_views(folder: Path, descriptors: Sequence[str]) -> npt.NDArray[np.uint8]:
    """Return the visual context of each object, made as the service makes it from an upload.

    Returns:
        uint8 (objects, 1, 32, 32), where 0..255 mean 0..1.

    Raises:
        DataError: A view is missing or broken. The message names the file.
    """
    if not folder.is_dir():
        raise DataError(f"{folder} is not a folder of top-down views; run 'cazsl-train images {folder}'")
    paths = [_find(folder, descriptor) for descriptor in descriptors]
    contexts = [visual_context(read_view(path)).levels for path in paths]
    return np.frombuffer(b"".join(contexts), dtype=np.uint8).reshape(-1, 1, VISUAL_SIZE, VISUAL_SIZE)


def camera_views_beside(views: Path) -> Path:
    """Return the folder of camera views that belongs to a folder of drawings: the one beside it."""
    return views.parent / f"{views.name}-cameras"


def camera_views_file_name(descriptor: str) -> str:
    """Return the name of the file with an object's camera views, uint8 [views, 32, 32]."""
    return f"{CAMERA_VIEWS_PREFIX}{descriptor}.npy"


def read_camera_views(folder: Path, descriptors: Sequence[str], count: int) -> View:
    """Return the first camera views of each object as visual contexts, uint8 (objects, count, 1, 32, 32).

    Raises:
        DataError: A file is missing, broken, or holds fewer views. The message names it.
    """
    return np.stack([_read_camera_views(folder / camera_views_file_name(name), count) for name in descriptors])


def _read_camera_views(path: Path, count: int) -> View:
    if not path.is_file():
        raise DataError(f"{path} is missing; draw it with: cazsl-train images --camera --views {count}")
    views = parse_npy(path, read_content(path, _CAMERA_VIEWS), _CAMERA_VIEWS)
    if views.dtype != np.uint8 or views.shape[1:] != (VISUAL_SIZE, VISUAL_SIZE) or len(views) < count:
        raise DataError(
            f"{path} has {views.dtype} of shape {views.shape}; expected uint8 of ({count} or more, {VISUAL_SIZE}, "
            f"{VISUAL_SIZE}); remove it and draw it again with: cazsl-train images --camera --views {count}"
        )
    return np.asarray(views[:count, None], dtype=np.uint8)


def read_view(path: Path) -> GreyImage:
    """Read one view.

    Raises:
        DataError: The file is not an image of the published size.
    """
    array = parse_npy(path, read_content(path, _VIEW), _VIEW)
    if array.shape != (VIEW_PIXELS, VIEW_PIXELS):
        raise DataError(
            f"{path} has shape {array.shape}; expected ({VIEW_PIXELS}, {VIEW_PIXELS}); fetch or draw it again"
        )
    try:
        return GreyImage.from_array(_as_fractions(array), path.name)
    except InvalidImageError as error:
        raise DataError(f"{path} is not an image ({error}); fetch or draw it again") from error


def convention_of(folder: Path) -> str:
    """Return the image convention of a folder of views, for the manifest of models trained on them.

    Raises:
        DataError: The folder's declaration has no image convention.
    """
    return read_declared(folder, "image_convention", UNKNOWN_CONVENTION)


def source_of(folder: Path) -> str:
    """Return the source of a folder of views, for every table, card and manifest made with them.

    Raises:
        DataError: The folder's declaration has no source.
    """
    return read_declared(folder, "source", UNKNOWN_SOURCE)


def _find(folder: Path, descriptor: str) -> Path:
    name = view_file_name(descriptor)
    found = [path for path in (folder / name, *sorted(folder.glob(f"[012]_weight/{name}"))) if path.is_file()]
    if not found:
        raise DataError(f"{folder / name} is missing; fetch it, or draw views into a folder: cazsl-train images FOLDER")
    if len(found) > 1:
        raise DataError(f"{found[1]} and {found[0]} are the same object; keep one of them")
    return found[0]


def _as_fractions(array: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Scale an array with values above 1 from 0..255 to 0..1. Arrays of 8 or 16 bits are returned unchanged."""
    if array.dtype.kind in "iuf" and array.dtype not in (np.uint8, np.uint16):
        array = array.astype(np.float64)
        return array / 255.0 if array.max() > 1.0 else array
    return array
