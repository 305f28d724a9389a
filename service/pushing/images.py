"""From a picture to the visual context: decoded safely, cropped, reduced to 32 x 32, told what is odd about it.

``visual_context`` is the one conversion: the trainer calls it with arrays read from disk, the service with what
``decode`` made of an upload. It counts in whole numbers, so that every machine gives the same bytes.

How pixels become one grey level in [0, 1]:

- colour: luma 0.299 R + 0.587 G + 0.114 B (ITU-R BT.601), rounded; a palette is looked up first, CMYK becomes RGB;
- alpha, or a colour declared transparent: composited onto the background level, black;
- 16 bits: grey keeps them all; with colour or alpha the upper 8 are read;
- 1, 2 and 4 bits: spread over [0, 1];
- EXIF orientation: applied, in all three formats; gamma and colour profiles: ignored.
"""

import io
import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Final, Self

import numpy as np
import numpy.typing as npt
from PIL import Image

from service.errors import InvalidImageError, RequestError
from service.pushing.contexts import VISUAL_SIZE, VisualContext
from service.pushing.image_files import ImageLimits, read_image_file
from service.pushing.image_quality import QualityFlag, quality_flags, thumbnail_png

__all__ = [
    "BACKGROUND_LEVEL",
    "BODY_LEVEL",
    "FIELD_OF_VIEW_M",
    "FULL_LEVEL_MASS_KG",
    "IMAGE_CONVENTION",
    "GreyImage",
    "ImageLimits",
    "QualityFlag",
    "decode",
    "quality_flags",
    "thumbnail_png",
    "visual_context",
]

FIELD_OF_VIEW_M: Final = 0.160  # across the square; every Omnipush object fits with 10 mm to spare
BACKGROUND_LEVEL: Final = 0.0
BODY_LEVEL: Final = 0.5
FULL_LEVEL_MASS_KG: Final = 0.150  # the weight that is white; lighter ones lie in proportion above the body's level
IMAGE_CONVENTION: Final = (
    "Top-down view, orthographic, one grey channel in [0, 1]. The middle square of the picture, as wide as its shorter "
    "side, shows 0.160 m x 0.160 m; its centre is the origin of the object frame (the centre of the core), the "
    "object's x axis (through side 1) points right, its y axis (through side 2) points up. Background 0.0 (black), "
    "object 0.5, a weight a disc of 10 mm radius at 0.5 + 0.5 * mass / 150 g: 0.7 for 60 g, 1.0 for 150 g. A longer "
    "side is cropped evenly, an odd pixel from the right or the bottom; the square is reduced to 32 x 32 as "
    "scikit-image's resize does by default (Gaussian of standard deviation (n/32 - 1)/2 pixels, then linear "
    "interpolation, mirrored at the border) and rounded to 8 bits, halves up."
)

Levels = npt.NDArray[np.uint8] | npt.NDArray[np.uint16]

_WEIGHT_BITS: Final = 18  # 16 bits of level and twice 18 of weight: every sum is a whole number below 2**53, so exact
_GAUSSIAN_REACH: Final = 4.0  # standard deviations, as in scipy's filter


@dataclass(frozen=True, eq=False)
class GreyImage:
    """One grey channel, [height, width], row 0 at the top; 0..255 or 0..65535 by its type, meaning 0..1."""

    levels: Levels

    @classmethod
    def from_array(cls, array: npt.NDArray[Any], where: str = "image") -> Self:
        """Take a picture from memory: 8 or 16 bits or truth values as they are, fractions in [0, 1] as 16 bits.

        Raises:
            InvalidImageError: not [height, width], empty, another type, not finite, or not in [0, 1].
        """
        if array.ndim != 2 or array.size == 0:
            raise _invalid(where, f"an array of shape {list(array.shape)}", "[height, width]")
        if array.dtype in (np.uint8, np.uint16):
            return cls(array.astype(array.dtype.newbyteorder("=")))
        if array.dtype.kind == "b":
            return cls(array.astype(np.uint8) * np.uint8(255))
        if array.dtype.kind != "f":
            raise _invalid(where, f"an array of {array.dtype}", "uint8, uint16, bool or floating point")
        if not (np.isfinite(array).all() and array.min() >= 0.0 and array.max() <= 1.0):
            raise _invalid(where, "a value that is not in [0, 1]", "grey levels from 0 (black) to 1 (white)")
        return cls(np.floor(array.astype(np.float64) * 65535.0 + 0.5).astype(np.uint16))

    @property
    def full_scale(self) -> int:
        """The number that means 1."""
        return int(np.iinfo(self.levels.dtype).max)


def decode(content: bytes, limits: ImageLimits = ImageLimits(), where: str = "image") -> GreyImage:  # noqa: B008 frozen
    """Read a PNG, JPEG or WebP file that nobody vouches for; blocking, so call it in a thread.

    Raises:
        ImageTooLargeError: bytes, pixels or a side over the limits.
        UnsupportedImageError: another format.
        InvalidImageError: broken, truncated, animated, or more than one picture.
    """
    file = read_image_file(content, limits, where)
    try:
        with Image.open(io.BytesIO(file.content), formats=(file.format,)) as image:
            if image.size != (file.width, file.height):
                raise _invalid(where, "a picture of another size than its header says", "a whole picture")
            image.load()
            levels = _levels(image)
    except (RequestError, MemoryError):
        raise
    except Exception as error:  # Pillow raises whatever its decoders trip over: no list of errors is complete
        raise _invalid(where, f"a {file.format} file whose pixels cannot be decoded", "a whole picture") from error
    return GreyImage(_upright(levels, file.orientation))


def visual_context(image: GreyImage) -> VisualContext:
    """The 32 x 32 levels that a model sees, by ``IMAGE_CONVENTION``; equal to scikit-image's resize within rounding."""
    square = _middle_square(image.levels)
    windows = _resize_windows(len(square))
    # einsum rather than a matrix product: BLAS would wake its threads for a millisecond's work
    rows = np.stack([np.einsum("i,ij->j", weights, square[window]) for window, weights in windows])
    total = np.stack([np.einsum("ij,j->i", rows[:, window], weights) for window, weights in windows], axis=1)
    one = image.full_scale << 2 * _WEIGHT_BITS
    rounded = (total.astype(np.int64) * (2 * 255) + one) // (2 * one)
    return VisualContext.from_bytes(rounded.astype(np.uint8).tobytes())


def _levels(image: Image.Image) -> Levels:
    """One grey channel of a decoded picture, by the rules at the top."""
    if image.mode.startswith("I;16"):
        levels = np.array(image).astype(np.uint16)
        levels[levels == image.info.get("transparency", -1)] = 0
        return levels
    if image.has_transparency_data:
        image = image.convert("RGBA")
        grey = Image.new("L", image.size, round(BACKGROUND_LEVEL * 255))
        grey.paste(image.convert("L"), mask=image.getchannel("A"))
        return np.asarray(grey)
    if image.mode not in ("1", "L", "RGB"):  # a copy of what is RGB takes longer than its luma, and frees under the GIL
        image = image.convert("RGB")
    return np.asarray(image if image.mode == "L" else image.convert("L"))


def _upright(levels: Levels, orientation: int) -> Levels:
    """Undo what a camera says it did (EXIF 3.0, tag 0x0112): where row 0 and column 0 of the scene are."""
    if orientation in (5, 6, 7, 8):
        levels = levels.T
    if orientation in (2, 3, 6, 7):
        levels = levels[:, ::-1]
    if orientation in (3, 4, 7, 8):
        levels = levels[::-1]
    return levels


def _middle_square(levels: Levels) -> Levels:
    height, width = levels.shape
    side = min(height, width)
    top, left = (height - side) // 2, (width - side) // 2
    return levels[top : top + side, left : left + side]


@lru_cache(maxsize=8)
def _resize_windows(side: int) -> tuple[tuple[slice, npt.NDArray[np.float64]], ...]:
    """Which pixels each of the 32 cells along an axis takes, and how much of each: units of 2**-18 that sum to one."""
    factor = side / VISUAL_SIZE
    sigma = max(0.0, (factor - 1.0) / 2.0)
    reach = int(_GAUSSIAN_REACH * sigma + 0.5)
    steps = np.arange(-reach, reach + 1)
    kernel = np.array([math.exp(-0.5 * (step / sigma) ** 2) if step else 1.0 for step in steps])
    unit = 1 << _WEIGHT_BITS
    windows = []
    for cell in range(VISUAL_SIZE):
        centre = (cell + 0.5) * factor - 0.5
        pixel = math.floor(centre)
        weights = np.zeros(side)
        for near, share in ((pixel, pixel + 1 - centre), (pixel + 1, centre - pixel)):
            np.add.at(weights, _mirrored(near + steps, side), share * kernel / kernel.sum())
        weights = np.rint(weights * unit)
        weights[weights.argmax()] += unit - weights.sum()
        used = np.flatnonzero(weights)
        window = slice(int(used[0]), int(used[-1]) + 1)
        windows.append((window, weights[window].copy()))
    return tuple(windows)


def _mirrored(index: npt.NDArray[np.int64], side: int) -> npt.NDArray[np.int64]:
    """Pixels beyond the border are those inside it, the border's own not repeated."""
    period = max(1, 2 * (side - 1))
    index = index % period
    return np.minimum(index, period - index)


def _invalid(where: str, received: str, accepted: str) -> InvalidImageError:
    return InvalidImageError.at(where, received, accepted)
