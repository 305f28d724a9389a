"""Top-down views of Omnipush objects: drawn from their geometry, written and read in Omnipush's own file format.

A folder of views holds ``shape_<descriptor>.npy``, 481 x 481, one grey level per pixel, as published; the release sorts
them into ``0_weight``, ``1_weight`` and ``2_weight``, which are looked into as well. What a level means, and where the
object's axes point, is ``service.pushing.images.IMAGE_CONVENTION``. Neither is published for the real files, nor is their type:
ours are uint8, and any numeric type is read. A folder that this project drew says so in ``dataset.json``.
"""

import hashlib
import io
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from tqdm import tqdm

from service.errors import DataError, InvalidImageError
from service.pushing.contexts import VISUAL_SIZE, ObjectContext
from service.pushing.images import (
    BACKGROUND_LEVEL,
    BODY_LEVEL,
    FIELD_OF_VIEW_M,
    FULL_LEVEL_MASS_KG,
    IMAGE_CONVENTION,
    GreyImage,
    visual_context,
)
from training.omnipush import pushes as data
from training.omnipush.files import write_array
from training.simulation.camera import camera_view
from training.simulation.solids import WEIGHT_RADIUS_M, Polygon, Weight, clearance_m, solid

VIEW_PIXELS: Final = 481  # odd: the object's centre is the middle of pixel 240
PIXEL_M: Final = FIELD_OF_VIEW_M / VIEW_PIXELS
UNKNOWN_CONVENTION: Final = (
    "Top-down views of undeclared origin (481 x 481, as Omnipush publishes them): field of view, orientation and "
    "intensities are not stated with the files; reduced to 32 x 32 as the paper does."
)
UNKNOWN_SOURCE: Final = "top-down views of undeclared origin"
_MAX_FILE_BYTES: Final = VIEW_PIXELS**2 * 8 + 4096  # float64 and a header
_REFERENCE_OBJECT: Final = "1a2C3b4a"  # every shape and both weights

View = npt.NDArray[np.uint8]
Plane = npt.NDArray[np.float64]


def top_down_view(context: ObjectContext) -> View:
    """The object as seen from straight above, uint8 [481, 481], by ``IMAGE_CONVENTION``."""
    body = solid(context)
    coverage = np.zeros((VIEW_PIXELS, VIEW_PIXELS))
    for piece in body.pieces:
        _add_coverage(coverage, piece)
    # Pieces touch but do not overlap: on a seam each covers half of a pixel.
    levels = BACKGROUND_LEVEL + np.minimum(coverage, 1.0) * (BODY_LEVEL - BACKGROUND_LEVEL)
    for weight in body.weights:
        disc = _disc_coverage(weight)
        levels += disc * (weight_level(weight.mass_kg) - levels)
    return np.floor(levels * 255.0 + 0.5).astype(np.uint8)


def weight_level(mass_kg: float) -> float:
    """How bright a weight is: in proportion to its mass, from the body's level up to white."""
    return BODY_LEVEL + (1.0 - BODY_LEVEL) * mass_kg / FULL_LEVEL_MASS_KG


def photograph(descriptor: str, seed: int) -> View:
    """The object's view as a camera would see it; the same for the same object and seed, whatever was drawn before."""
    rng = np.random.default_rng([seed, *b"camera", *descriptor.encode()])
    return camera_view(top_down_view(ObjectContext.from_descriptor(descriptor)), rng)


def write_views(
    folder: Path, descriptors: Sequence[str], camera: bool = False, seed: int = 0, quiet: bool = False
) -> None:
    """Draw every view that the folder does not hold yet, clean or as a camera sees it.

    The files depend on object and seed alone, not on order, interruption, or who else draws into the folder.

    Raises:
        DataError: the folder holds something else, or cannot be written to.
    """
    data.declare_dataset(folder, _declaration(camera, seed))
    missing = [descriptor for descriptor in descriptors if not (folder / _file_name(descriptor)).is_file()]
    for descriptor in tqdm(missing, desc="drawing", unit="object", disable=quiet):
        view = photograph(descriptor, seed) if camera else top_down_view(ObjectContext.from_descriptor(descriptor))
        write_array(folder / _file_name(descriptor), view)


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
    path = folder / data.DATASET_FILE
    if not path.is_file():
        return otherwise
    try:
        return str(json.loads(path.read_text(encoding="utf-8"))[key])
    except (ValueError, KeyError, TypeError) as error:
        raise DataError(f"{path} says nothing of pictures (key '{key}'); name a folder of views") from error


def _declaration(camera: bool, seed: int) -> dict[str, Any]:
    reference = top_down_view(ObjectContext.from_descriptor(_REFERENCE_OBJECT))
    return {
        "source": f"simulated top-down views (camera, seed {seed})" if camera else "simulated top-down views",
        "simulated": True,
        "camera": camera,
        "seed": seed if camera else None,
        "image_convention": IMAGE_CONVENTION,
        "view_sha256": hashlib.sha256(reference.tobytes()).hexdigest(),
    }


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


def _add_coverage(coverage: Plane, piece: Polygon) -> None:
    """Add how much of each pixel a convex piece covers, from the distance of the pixel's middle to the outline."""
    middle = VIEW_PIXELS // 2
    left, bottom = np.floor(piece.min(axis=0) / PIXEL_M).astype(int) - 1
    right, top = np.ceil(piece.max(axis=0) / PIXEL_M).astype(int) + 1
    columns, rows = slice(middle + left, middle + right + 1), slice(middle - top, middle - bottom + 1)
    x_m, y_m = _pixel_positions()
    window = np.stack(np.broadcast_arrays(x_m[:, columns], y_m[rows]), axis=-1)
    distance = clearance_m(piece, window.reshape(-1, 2)).reshape(window.shape[:2])
    coverage[rows, columns] += np.clip(0.5 - distance / PIXEL_M, 0.0, 1.0)


def _disc_coverage(weight: Weight) -> Plane:
    x_m, y_m = _pixel_positions()
    distance = np.hypot(x_m - weight.x_m, y_m - weight.y_m) - WEIGHT_RADIUS_M
    covered: Plane = np.clip(0.5 - distance / PIXEL_M, 0.0, 1.0)
    return covered


def _pixel_positions() -> tuple[Plane, Plane]:
    """Metres along x of each column (1, 481) and along y of each row (481, 1): x points right, y points up."""
    offset_m = (np.arange(VIEW_PIXELS, dtype=np.float64) - VIEW_PIXELS // 2) * np.float64(PIXEL_M)
    return offset_m[None, :], -offset_m[:, None]
