"""Top-down views of Omnipush objects, drawn from their geometry and written in Omnipush's file format.

A folder of views holds ``shape_<descriptor>.npy``, 481 x 481 uint8, one grey level per pixel. The meaning of a level
and the directions of the object's axes are those of ``service.pushing.images.IMAGE_CONVENTION``. Neither is published
for the files of the release. A folder that this project drew has a declaration, ``dataset.json``.
"""

import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from tqdm import tqdm

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
from service.pushing.sides import Polygon
from training.omnipush.declaration import declare_dataset
from training.omnipush.npy_files import write_npy
from training.omnipush.views import VIEW_PIXELS, View, camera_views_file_name, view_file_name
from training.simulation.camera import camera_view
from training.simulation.solids import WEIGHT_RADIUS_M, Weight, clearance_m, solid

PIXEL_M: Final = FIELD_OF_VIEW_M / VIEW_PIXELS
_REFERENCE_OBJECT: Final = "1a2C3b4a"  # every shape and both weights

Plane = npt.NDArray[np.float64]


def top_down_view(context: ObjectContext) -> View:
    """Draw an object as seen from straight above, uint8 [481, 481], by ``IMAGE_CONVENTION``."""
    body = solid(context)
    coverage = np.zeros((VIEW_PIXELS, VIEW_PIXELS))
    for piece in body.pieces:
        _add_coverage(coverage, piece)
    # Pieces touch but do not overlap. On a seam each covers half of a pixel.
    levels = BACKGROUND_LEVEL + np.minimum(coverage, 1.0) * (BODY_LEVEL - BACKGROUND_LEVEL)
    for weight in body.weights:
        disc = _disc_coverage(weight)
        levels += disc * (weight_level(weight.mass_kg) - levels)
    return np.floor(levels * 255.0 + 0.5).astype(np.uint8)


def weight_level(mass_kg: float) -> float:
    """Return the grey level of a weight, 0..1: proportional to its mass, from the body's level up to white."""
    return BODY_LEVEL + (1.0 - BODY_LEVEL) * mass_kg / FULL_LEVEL_MASS_KG


def photograph(descriptor: str, seed: int) -> View:
    """Draw an object's view as a camera would see it. The image depends on object and seed alone."""
    return camera_view(top_down_view(ObjectContext.from_descriptor(descriptor)), _generator(descriptor, seed))


def _generator(descriptor: str, seed: int) -> np.random.Generator:
    return np.random.default_rng([seed, *b"camera", *descriptor.encode()])


def write_views(
    folder: Path, descriptors: Sequence[str], camera: bool = False, seed: int = 0, quiet: bool = False
) -> None:
    """Draw every view that the folder does not hold yet, clean or as a camera sees it.

    The files depend on object and seed alone. Order, interruption and other processes that draw into the same folder
    do not change them.

    Raises:
        DataError: The folder holds other data, or cannot be written.
    """
    declare_dataset(folder, _declaration(camera, seed))
    missing = [descriptor for descriptor in descriptors if not (folder / view_file_name(descriptor)).is_file()]
    for descriptor in tqdm(missing, desc="drawing", unit="object", disable=quiet):
        view = photograph(descriptor, seed) if camera else top_down_view(ObjectContext.from_descriptor(descriptor))
        write_npy(folder / view_file_name(descriptor), view)


def write_camera_views(
    folder: Path, descriptors: Sequence[str], count: int, seed: int = 0, quiet: bool = False
) -> None:
    """Draw camera views of every object that the folder does not hold yet, each reduced to a visual context.

    The views of an object are its photographs with the seeds ``seed``, ``seed + 1`` and so on.

    Raises:
        DataError: The folder holds other data, or cannot be written.
    """
    declare_dataset(folder, {**_declaration(True, seed), "views": count})
    missing = [name for name in descriptors if not (folder / camera_views_file_name(name)).is_file()]
    for descriptor in tqdm(missing, desc="drawing", unit="object", disable=quiet):
        view = top_down_view(ObjectContext.from_descriptor(descriptor))
        seen = (camera_view(view, _generator(descriptor, seed + number)) for number in range(count))
        levels = [visual_context(GreyImage.from_array(each, descriptor)).levels for each in seen]
        contexts = np.frombuffer(b"".join(levels), dtype=np.uint8).reshape(count, VISUAL_SIZE, VISUAL_SIZE)
        write_npy(folder / camera_views_file_name(descriptor), contexts)


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


def _add_coverage(coverage: Plane, piece: Polygon) -> None:
    """Add the share of each pixel that a convex piece covers, from the distance of its middle to the outline."""
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
    """Return metres along x of each column (1, 481) and along y of each row (481, 1): x points right, y points up."""
    offset_m = (np.arange(VIEW_PIXELS, dtype=np.float64) - VIEW_PIXELS // 2) * np.float64(PIXEL_M)
    return offset_m[None, :], -offset_m[:, None]
