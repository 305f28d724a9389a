"""Top-down views of Omnipush objects: read from the files of the release or of the simulation."""

import io
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from service.errors import DataError, InvalidImageError
from service.pushing.contexts import VISUAL_SIZE
from service.pushing.images import (
    GreyImage,
    visual_context,
)
from training.omnipush.declaration import DATASET_FILE

VIEW_PIXELS: Final = 481  # odd: the object's centre is the middle of pixel 240
UNKNOWN_CONVENTION: Final = (
    "Top-down views of undeclared origin (481 x 481, as Omnipush publishes them): field of view, orientation and "
    "intensities are not stated with the files; reduced to 32 x 32 as the paper does."
)
UNKNOWN_SOURCE: Final = "top-down views of undeclared origin"
_MAX_FILE_BYTES: Final = VIEW_PIXELS**2 * 8 + 4096  # float64 and a header
View = npt.NDArray[np.uint8]


def read_views(folder: Path, descriptors: Sequence[str]) -> npt.NDArray[np.uint8]:
    """The visual context of each object, uint8 (objects, 1, 32, 32), 0..255 meaning 0..1; by the service's conversion.

    Raises:
        DataError: names the file at fault, what was expected and what to do.
    """
    if not folder.is_dir():
        raise DataError(f"{folder} is not a folder of top-down views; run 'cazsl-train images {folder}'")
    paths = [_find(folder, descriptor) for descriptor in descriptors]
    contexts = [visual_context(read_view(path)).levels for path in paths]
    return np.frombuffer(b"".join(contexts), dtype=np.uint8).reshape(-1, 1, VISUAL_SIZE, VISUAL_SIZE)


def read_view(path: Path) -> GreyImage:
    """One view from its file.

    Raises:
        DataError: it is no picture of the published size; names the file and what to do.
    """
    try:
        with path.open("rb") as file:
            content = file.read(_MAX_FILE_BYTES + 1)
    except OSError as error:
        raise DataError(f"{path} cannot be read ({error.strerror}); make it readable or fetch it again") from error
    if len(content) > _MAX_FILE_BYTES:
        raise DataError(f"{path} has more than {_MAX_FILE_BYTES} bytes: no view of 481 x 481; fetch or draw it again")
    try:
        array = np.load(io.BytesIO(content), allow_pickle=False)
    except Exception as error:  # numpy parses the header with whatever it finds: no list of errors is complete
        raise DataError(f"{path} is not a whole .npy file of numbers; fetch or draw it again") from error
    if not isinstance(array, np.ndarray) or array.shape != (VIEW_PIXELS, VIEW_PIXELS):
        shape = getattr(array, "shape", "no array")
        raise DataError(f"{path} has shape {shape}; expected ({VIEW_PIXELS}, {VIEW_PIXELS}); fetch or draw it again")
    try:
        return GreyImage.from_array(_as_fractions(array), path.name)
    except InvalidImageError as error:
        raise DataError(f"{path} is no picture ({error}); fetch or draw it again") from error


def convention_of(folder: Path) -> str:
    """What is known of how the pictures of a folder were taken, for the manifest of models trained on them.

    Raises:
        DataError: the folder's declaration says nothing of its pictures.
    """
    return _declared(folder, "image_convention", UNKNOWN_CONVENTION)


def source_of(folder: Path) -> str:
    """Where the pictures of a folder come from, for every table, card and manifest made with them.

    Raises:
        DataError: the folder's declaration does not say.
    """
    return _declared(folder, "source", UNKNOWN_SOURCE)


def _declared(folder: Path, key: str, otherwise: str) -> str:
    path = folder / DATASET_FILE
    if not path.is_file():
        return otherwise
    try:
        return str(json.loads(path.read_text(encoding="utf-8"))[key])
    except (ValueError, KeyError, TypeError) as error:
        raise DataError(f"{path} says nothing of pictures (key '{key}'); name a folder of views") from error


def _file_name(descriptor: str) -> str:
    return f"shape_{descriptor}.npy"


def _find(folder: Path, descriptor: str) -> Path:
    name = _file_name(descriptor)
    found = [path for path in (folder / name, *sorted(folder.glob(f"[012]_weight/{name}"))) if path.is_file()]
    if not found:
        raise DataError(f"{folder / name} is missing; fetch it, or draw views into a folder: cazsl-train images FOLDER")
    if len(found) > 1:
        raise DataError(f"{found[1]} and {found[0]} are the same object; keep one of them")
    return found[0]


def _as_fractions(array: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Numbers beyond 1, whole or not, count as 0..255; what is in [0, 1] or has 8 or 16 bits stays as it is."""
    if array.dtype.kind in "iuf" and array.dtype not in (np.uint8, np.uint16):
        array = array.astype(np.float64)
        return array / 255.0 if array.max() > 1.0 else array
    return array


VIEWS_FOLDER: Final = "top-down_view"


def views_beside(folder: Path) -> Path:
    """Where the top-down views of a surface's objects are unless said otherwise: beside it, as Omnipush has them."""
    return folder.parent / VIEWS_FOLDER
