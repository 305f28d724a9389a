"""Quality of a visual context: flags for a blank, clipped or off-centre view and several objects, and a thumbnail."""

import io
from collections.abc import Iterator
from enum import StrEnum
from typing import Final

import numpy as np
import numpy.typing as npt
from PIL import Image

from service.pushing.contexts import VISUAL_SIZE, VisualContext

_THUMBNAIL_SCALE: Final = 8
_LEAST_CONTRAST: Final = 0.15  # between the mean levels of object and background
_OFF_CENTRE_CELLS: Final = 2.5  # 12 mm. An object's middle lies up to 6 mm from its core's centre.
_SECOND_OBJECT_SHARE: Final = 0.03  # of the largest object's area: a box of 16 mm beside an object of Omnipush
_ROW: Final = (1 << VISUAL_SIZE) - 1
_NOT_FIRST: Final = sum((_ROW - 1) << VISUAL_SIZE * row for row in range(VISUAL_SIZE))  # cells with one on their left
_NOT_LAST: Final = sum((_ROW >> 1) << VISUAL_SIZE * row for row in range(VISUAL_SIZE))


class QualityFlag(StrEnum):
    """Flag of a fault in a picture. A prediction from such a picture may be poor."""

    BLANK = "blank"  # no object stands out from the background
    CLIPPED = "clipped"  # the object touches the border
    OFF_CENTRE = "off_centre"  # the object's middle is not the picture's
    SEVERAL_OBJECTS = "several_objects"


def quality_flags(context: VisualContext) -> tuple[QualityFlag, ...]:
    """Return the faults of a picture, judged on its visual context."""
    grey = np.frombuffer(context.levels, dtype=np.uint8).reshape(VISUAL_SIZE, VISUAL_SIZE)
    bright = bright_cells(grey)
    if grey.min() == grey.max() or grey[bright].mean() - grey[~bright].mean() < _LEAST_CONTRAST * 255:
        return (QualityFlag.BLANK,)
    areas = sorted(_connected(bright), key=int.bit_count, reverse=True)
    cells = _places(areas[0])
    lowest, highest = cells.min(axis=0), cells.max(axis=0)
    offset = np.abs((lowest + highest) / 2 - (VISUAL_SIZE - 1) / 2)
    found = {
        QualityFlag.CLIPPED: lowest.min() == 0 or highest.max() == VISUAL_SIZE - 1,
        QualityFlag.OFF_CENTRE: offset.max() > _OFF_CENTRE_CELLS,
        QualityFlag.SEVERAL_OBJECTS: len(areas) > 1 and areas[1].bit_count() > _SECOND_OBJECT_SHARE * len(cells),
    }
    return tuple(flag for flag, raised in found.items() if raised)


def bright_cells(grey: npt.NDArray[np.uint8]) -> npt.NDArray[np.bool_]:
    """Return the cells of a view (32, 32) that are brighter than its threshold."""
    return grey > _threshold(grey)


def thumbnail_png(context: VisualContext) -> bytes:
    """Return a visual context as a PNG of 256 x 256 pixels, every level a block of 8 x 8."""
    grey = np.frombuffer(context.levels, dtype=np.uint8).reshape(VISUAL_SIZE, VISUAL_SIZE)
    blocks = grey.repeat(_THUMBNAIL_SCALE, axis=0).repeat(_THUMBNAIL_SCALE, axis=1)
    buffer = io.BytesIO()
    # Pillow reads the array in place. For pixels of its own it would cut a kept block of memory to this size.
    Image.fromarray(blocks).save(buffer, "PNG")
    return buffer.getvalue()


def _threshold(grey: npt.NDArray[np.uint8]) -> int:
    """Return the level that divides dark from bright cells with the least spread within both (Otsu 1979)."""
    counts = np.bincount(grey.ravel(), minlength=256).astype(np.float64)
    below, sums = counts.cumsum(), (counts * np.arange(256)).cumsum()
    above = below[-1] - below
    spread = (sums[-1] * below - below[-1] * sums) ** 2 / np.maximum(below * above, 1.0)
    return int(spread.argmax())


def _connected(bright: npt.NDArray[np.bool_]) -> Iterator[int]:
    """Yield the patches of cells that touch side to side, each as the bits of a whole number: a cell is a bit."""
    remaining = int.from_bytes(np.packbits(bright, bitorder="little").tobytes(), "little")
    while remaining:
        patch, grown = 0, remaining & -remaining
        while grown != patch:
            patch = grown
            beside = (patch & _NOT_LAST) << 1 | (patch & _NOT_FIRST) >> 1 | patch << VISUAL_SIZE | patch >> VISUAL_SIZE
            grown |= beside & remaining
        remaining &= ~patch
        yield patch


def _places(patch: int) -> npt.NDArray[np.int64]:
    """Return rows and columns (k, 2) of the cells of a patch."""
    bits = np.frombuffer(patch.to_bytes(VISUAL_SIZE**2 // 8, "little"), dtype=np.uint8)
    return np.argwhere(np.unpackbits(bits, bitorder="little").reshape(VISUAL_SIZE, VISUAL_SIZE))
