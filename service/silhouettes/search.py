"""Search for the outline of the one object in a picture, in metres, with refusals that say how to cure a picture."""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from service.errors import InvalidRequestError
from service.pushing.image_quality import QualityFlag
from service.pushing.images import ColourImage
from service.pushing.outlines import LARGEST_EXTENT_M, MOST_CORNERS, SMALLEST_EXTENT_M, Outline
from service.pushing.poses import DoubleArray
from service.silhouettes import faults
from service.silhouettes.masks import mask_coverage
from service.silhouettes.segmentation import segment
from service.silhouettes.tracing import Region, regions, simplified
from service.turns import pause

IMAGE_FIELD: Final = "image"
SCALE_FIELD: Final = "metres_per_pixel"
SEVERAL_SHARE: Final = 0.25  # of the largest area: a second object as large as this makes the picture ambiguous
FLAGGED_SHARE: Final = 0.02  # ... or as this is worth a flag
LEAST_AREA: Final = 12.0  # pixels of an object
MOST_STEPS: Final = 50_000  # of a boundary, from pixel to pixel: a longer one fills the picture with folds
TOLERANCE: Final = 0.35  # pixels by which simplifying may move an outline
_BORDER: Final = 1.0  # pixels: as near as this to the border an object touches it


@dataclass(frozen=True)
class FoundOutline:
    """Outline found in a picture.

    Attributes:
        outline: in metres, in the picture's frame: the origin in its middle, x right, y up.
        flags: faults of the picture in spite of which it was found.
    """

    outline: Outline
    flags: tuple[QualityFlag, ...]


def find_outline(
    picture: ColourImage, metres_per_pixel: float, where: tuple[str, str] = (IMAGE_FIELD, SCALE_FIELD)
) -> FoundOutline:
    """Find the outline of the one object in a picture, with at most 512 corners. Holes are filled.

    Blocking, so call it in a thread.

    Args:
        picture: a mask (alpha, or black and white), or a photograph from above.
        metres_per_pixel: of the picture as it was sent, on the plane of the object.
        where: the fields of picture and scale, for errors.

    Raises:
        InvalidImageError: no single silhouette stands out. Says whether it is blank, clipped, or shows several.
        InvalidRequestError: with this scale the object is smaller than 5 mm or larger than 2 m.
        DeadlineError: see ``service.turns.pause``.
    """
    image_field, scale_field = where
    if not (math.isfinite(metres_per_pixel) and metres_per_pixel > 0.0):
        raise InvalidRequestError.at(scale_field, f"{metres_per_pixel:g}", "metres per pixel of the picture, above 0")
    pause()
    mask = mask_coverage(picture)
    found = regions(mask) if mask is not None else segment(picture.levels[..., :3])
    pause()
    region, flags = _judged(found, picture, image_field)
    corners = _simple(region, image_field) * picture.factor
    frame = np.array((picture.width, picture.height)) / 2.0
    corners = (corners - frame) * (metres_per_pixel, -metres_per_pixel)
    _check_scale(corners, metres_per_pixel, scale_field)
    return FoundOutline(Outline.of(corners, image_field), flags)


def _judged(found: list[Region], picture: ColourImage, where: str) -> tuple[Region, tuple[QualityFlag, ...]]:
    """Return the region of the object, and flags, or refuse the picture."""
    if not found or found[0].area < LEAST_AREA:
        raise faults.blank(where)
    region = found[0]
    rows, columns = picture.levels.shape[:2]
    low, high = region.boundary.min(axis=0), region.boundary.max(axis=0)
    if low.min() < _BORDER or (np.array((columns, rows)) - high).min() < _BORDER:
        raise faults.clipped(where)
    others = [other.area / region.area for other in found[1:]]
    similar = sum(share > SEVERAL_SHARE for share in others)
    if similar:
        raise faults.several_objects(where, 1 + similar)
    flagged = any(share > FLAGGED_SHARE for share in others)
    return region, (QualityFlag.SEVERAL_OBJECTS,) if flagged else ()


def _simple(region: Region, where: str) -> DoubleArray:
    """Return a boundary as a simple polygon of few corners, in pixels. Simplified less where edges would cross."""
    if len(region.boundary) > MOST_STEPS:
        raise faults.unclear(where)
    for tolerance in (TOLERANCE, TOLERANCE / 4.0, 0.0):
        corners = simplified(region.boundary, MOST_CORNERS, tolerance)
        try:
            Outline.of(corners / max(float(np.ptp(corners, axis=0).max()), 1.0))  # 1 m across: only its form counts
        except InvalidRequestError:
            continue
        return corners
    raise faults.unclear(where)


def _check_scale(corners: DoubleArray, metres_per_pixel: float, where: str) -> None:
    """Accept a scale that gives the object a size between 5 mm and 2 m."""
    extent_m = float(np.sqrt(((corners[:, None] - corners) ** 2).sum(axis=2).max()))
    if not SMALLEST_EXTENT_M <= extent_m <= LARGEST_EXTENT_M:
        low, high = (metres_per_pixel * limit / extent_m for limit in (SMALLEST_EXTENT_M, LARGEST_EXTENT_M))
        raise InvalidRequestError.at(
            where,
            f"{metres_per_pixel:g}, with which the object is {extent_m:.4g} m across",
            f"{low:.3g} to {high:.3g} for this picture: objects of 0.005 to 2 m",
        )
