"""Arguments of the clients: arrays, contexts and images as parts of the body of a request."""

import os
from pathlib import Path
from typing import Any, Final, TypedDict

import numpy as np
import numpy.typing as npt

from service.client.errors import ProblemError
from service.schemas.contexts import ContextBody
from service.schemas.image_contexts import OutlineContextBody, VisualContextBody

Context = str | ContextBody | VisualContextBody | OutlineContextBody
"""Context of an object: a descriptor, any ``ContextBody``, or the answer to ``make_context`` or ``find_outline``."""
Image = bytes | str | os.PathLike[str]
"""The content of a PNG, JPEG or WebP file, or its path."""
POSE_PARTS: Final = 3
_REAL_KINDS: Final = "fiu"


class _Properties(TypedDict, total=False):
    centre_of_mass: npt.ArrayLike
    friction: float
    pusher_radius: float
    pressure: npt.ArrayLike


class Details(_Properties, total=False):
    """Scale of an image, and properties of the object of any shape that it shows. Each may be left out.

    They are those of ``ContextBody``, which has their meaning and units.
    """

    metres_per_pixel: float


class ScaledDetails(_Properties):
    """Details with the scale, so that the object in an image becomes an outline."""

    metres_per_pixel: float


def context_document(context: Context) -> dict[str, Any]:
    """Return the document of a context."""
    match context:
        case str():
            return {"descriptor": context}
        case VisualContextBody():
            return {"visual": context.visual}
        case OutlineContextBody():
            return context_document(context.context)
        case _:
            return context.model_dump(exclude_none=True)


def lengths_field(lengths: npt.ArrayLike | None) -> dict[str, Any]:
    """Return the field of lengths: one number, or one per push.

    Raises:
        ProblemError: they have another shape, or a number is not finite.
    """
    if lengths is None:
        return {}
    found = finite_array(lengths, "lengths")
    if found.ndim > 1:
        raise ProblemError.at("lengths", f"shape {found.shape}", "one number, or shape (n,): in m")
    return {"lengths": found if found.ndim else float(found)}


def detail_fields(details: Details | ScaledDetails) -> dict[str, Any]:
    """Return the fields of details, as numbers and lists of numbers.

    Raises:
        ProblemError: a number is not finite.
    """
    return {name: finite_array(value, name).tolist() for name, value in details.items()}  # type: ignore[arg-type]


def pose_document(pose: npt.ArrayLike, where: str) -> dict[str, float]:
    """Return the document of a pose (3,).

    Raises:
        ProblemError: it is not three finite numbers.
    """
    parts = finite_array(pose, where)
    if parts.shape != (POSE_PARTS,):
        raise ProblemError.at(where, f"shape {parts.shape}", "three numbers: x and y in m, angle in rad")
    return dict(zip(("x", "y", "angle"), parts.tolist(), strict=True))


def pose_rows(poses: npt.ArrayLike, where: str) -> npt.NDArray[np.float64]:
    """Return poses (n, 3) as an array.

    Raises:
        ProblemError: they have another shape, or a number is not finite.
    """
    rows = finite_array(poses, where)
    if rows.ndim != 2 or rows.shape[1] != POSE_PARTS:
        raise ProblemError.at(where, f"shape {rows.shape}", "shape (n, 3): x and y in m, angle in rad")
    return rows


def finite_array(numbers: npt.ArrayLike, where: str) -> npt.NDArray[np.float64]:
    """Return the numbers as contiguous float64. NaN is refused here, because JSON would send null for it.

    Raises:
        ProblemError: a number is not finite, or the array holds none.
    """
    given = _as_array(numbers, where)
    if given.dtype.kind not in _REAL_KINDS:
        raise ProblemError.at(where, f"an array of {given.dtype}", "an array of real numbers")
    found = np.asarray(given, dtype=np.float64, order="C")
    wrong = np.argwhere(~np.isfinite(found))
    if len(wrong):
        place = ".".join((where, *(str(int(part)) for part in wrong[0])))
        raise ProblemError.at(place, "a number that is not finite", "finite numbers")
    return found


def _as_array(numbers: npt.ArrayLike, where: str) -> npt.NDArray[Any]:
    try:
        return np.asarray(numbers)
    except ValueError as error:
        raise ProblemError.at(where, "rows of different lengths", "an array of real numbers") from error


def index_array(index: npt.ArrayLike) -> npt.NDArray[np.int64]:
    """Return the index of contexts (n,) as an array.

    Raises:
        ProblemError: it has another shape or type.
    """
    found = _as_array(index, "context_index")
    if found.ndim != 1 or not np.issubdtype(found.dtype, np.integer):
        received = f"shape {found.shape} of {found.dtype}"
        raise ProblemError.at("context_index", received, "shape (n,) of integers: one per push")
    return np.ascontiguousarray(found, dtype=np.int64)


def image_content(image: Image) -> bytes:
    """Return the content of an image file."""
    return image if isinstance(image, bytes) else Path(image).read_bytes()
