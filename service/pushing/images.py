"""Images: pictures decoded safely, and the visual context, which is cropped and reduced to 32 x 32 grey levels.

``visual_context`` is the only conversion. The trainer calls it with arrays from disk, the service with pictures that
``decode`` read from uploads. It computes in whole numbers, so every machine gives the same bytes. ``decode_colour``
keeps colour and alpha for ``service.silhouettes``, which finds the outline of an object.

Pixels become one grey level in [0, 1] by these rules:

- colour: luma 0.299 R + 0.587 G + 0.114 B (ITU-R BT.601), rounded. A palette is looked up first, CMYK becomes RGB.
- alpha, or a colour declared transparent: composited onto the background level, black.
- 16 bits: grey keeps them all. With colour or alpha the upper 8 are read.
- 1, 2 and 4 bits: spread over [0, 1].
- orientation in EXIF, XMP or ImageMagick's text is applied as ``ImageOps.exif_transpose`` does, in all three formats.
- gamma and colour profiles are ignored.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Final, Self, TypeVar

import numpy as np
import numpy.typing as npt
from PIL import ExifTags, Image

from service.errors import InvalidImageError, RequestError
from service.pushing.contexts import VISUAL_SIZE, VisualContext
from service.pushing.image_files import ImageLimits, bound_image_file, check_metadata, open_image_file
from service.turns import pause

FIELD_OF_VIEW_M: Final = 0.160  # across the square. Every Omnipush object fits with 10 mm to spare.
BACKGROUND_LEVEL: Final = 0.0
BODY_LEVEL: Final = 0.5
FULL_LEVEL_MASS_KG: Final = 0.150  # the weight that is white. Lighter ones lie in proportion above the body's level.
IMAGE_CONVENTION: Final = (
    "Top-down view, orthographic, one grey channel in [0, 1]. The middle square of the picture, as wide as its shorter "
    "side, shows 0.160 m x 0.160 m; its centre is the origin of the object frame (the centre of the core), the "
    "object's x axis (through side 1) points right, its y axis (through side 2) points up. Background 0.0 (black), "
    "object 0.5, a weight a disc of 10 mm radius at 0.5 + 0.5 * mass / 150 g: 0.7 for 60 g, 1.0 for 150 g. A longer "
    "side is cropped evenly, an odd pixel from the right or the bottom; the square is reduced to 32 x 32 as "
    "scikit-image's resize does by default (Gaussian of standard deviation (n/32 - 1)/2 pixels, then linear "
    "interpolation, mirrored at the border) and rounded to 8 bits, halves up."
)
_WEIGHT_BITS: Final = 18  # with 16 bits of level and twice 18 of weight, every sum is an integer below 2**53: exact
LARGEST_COLOUR_SIDE: Final = 2048  # pixels. A larger picture is reduced by a whole factor.
_BAND_PIXELS: Final = 1 << 18  # turned to grey, or to colour with alpha, at a time
_GAUSSIAN_REACH: Final = 4.0  # standard deviations, as in scipy's filter

Levels = npt.NDArray[np.uint8] | npt.NDArray[np.uint16]
_Decoded = TypeVar("_Decoded")


@dataclass(frozen=True, eq=False)
class GreyImage:
    """Image of one grey channel, [height, width], row 0 at the top. Levels 0..255 or 0..65535 (by type) mean 0..1."""

    levels: Levels

    @classmethod
    def from_array(cls, array: npt.NDArray[Any], where: str = "image") -> Self:
        """Create an image from an array: 8 bits, 16 bits or booleans as they are, fractions in [0, 1] as 16 bits.

        Raises:
            InvalidImageError: the array is not [height, width], is empty, or has another type or values outside [0, 1].
        """
        if array.ndim != 2 or array.size == 0:
            raise InvalidImageError.at(where, f"an array of shape {list(array.shape)}", "[height, width]")
        if array.dtype in (np.uint8, np.uint16):
            return cls(array.astype(array.dtype.newbyteorder("=")))
        if array.dtype.kind == "b":
            return cls(array.astype(np.uint8) * np.uint8(255))
        if array.dtype.kind != "f":
            raise InvalidImageError.at(where, f"an array of {array.dtype}", "uint8, uint16, bool or floating point")
        if not (np.isfinite(array).all() and array.min() >= 0.0 and array.max() <= 1.0):
            raise InvalidImageError.at(
                where, "a value that is not in [0, 1]", "grey levels from 0 (black) to 1 (white)"
            )
        return cls(np.floor(array.astype(np.float64) * 65535.0 + 0.5).astype(np.uint16))

    @property
    def full_scale(self) -> int:
        """Return the level that means 1."""
        return int(np.iinfo(self.levels.dtype).max)


@dataclass(frozen=True, eq=False)
class ColourImage:
    """Image in colour, with a longer side of at most 2048 pixels, each of ``factor`` x ``factor`` pixels as sent.

    Attributes:
        levels: [rows, columns, 4], red, green, blue and alpha of 8 bits, row 0 at the top.
        width, height: size as sent, in pixels, upright. The last column and row may lie partly beyond it.
        factor: pixels as sent along each side of one in ``levels``.
    """

    levels: npt.NDArray[np.uint8]
    width: int
    height: int
    factor: int = 1

    @classmethod
    def from_array(cls, array: npt.NDArray[Any], where: str = "image") -> Self:
        """Create an image from grey levels [height, width], or colours [height, width, 3 or 4], of 8 bits.

        Raises:
            InvalidImageError: the array has another shape or type, or is empty.
        """
        if array.dtype != np.uint8 or array.size == 0 or not (array.ndim == 2 or array.shape[2:] in ((3,), (4,))):
            received = f"an array of {array.dtype} and shape {list(array.shape)}"
            raise InvalidImageError.at(where, received, "uint8 of [height, width], or [height, width, 3 or 4]")
        return cls(*_colour_levels(Image.fromarray(array)))


def decode(content: bytes, limits: ImageLimits = ImageLimits(), where: str = "image") -> GreyImage:  # noqa: B008 frozen
    """Decode an untrusted PNG, JPEG or WebP file to grey. Blocking, so call it in a thread.

    Raises:
        ImageTooLargeError: bytes, pixels, a side or the decoder's memory are over the limits.
        UnsupportedImageError: the file has another format.
        InvalidImageError: the picture is broken, truncated or animated, or costs more than a picture needs.
        DeadlineError: see ``service.turns.pause``.
    """
    return _decoded(content, limits, where, lambda image: GreyImage(_upright(_levels(image), _orientation(image))))


def decode_colour(
    content: bytes,
    limits: ImageLimits = ImageLimits(),  # noqa: B008 frozen
    where: str = "image",
) -> ColourImage:
    """Decode an untrusted PNG, JPEG or WebP file to colour and alpha. Blocking, so call it in a thread.

    Grey of 16 bits becomes 8, and CMYK becomes RGB. The limits and errors are those of ``decode``.
    """
    return _decoded(content, limits, where, _upright_colour)


def _decoded(content: bytes, limits: ImageLimits, where: str, convert: Callable[[Image.Image], _Decoded]) -> _Decoded:
    """Open and load a file within its limits, and convert it."""
    file = bound_image_file(content, limits, where)
    pause(file.needed_bytes)
    with open_image_file(content, file, where) as image:
        try:
            image.load()
            check_metadata(image, where)
            return convert(image)
        except (RequestError, MemoryError):
            raise
        except Exception as error:  # Pillow's decoders raise errors of any class, so no list of them is complete
            received = f"a {image.format} file whose pixels cannot be decoded"
            raise InvalidImageError.at(where, received, "a whole picture") from error


def visual_context(image: GreyImage) -> VisualContext:
    """Return the 32 x 32 levels that a model takes, by ``IMAGE_CONVENTION``: scikit-image's resize, within rounding."""
    square = _middle_square(image.levels)
    windows = _resize_windows(len(square))
    # einsum rather than a matrix product, for which BLAS would wake its threads for a millisecond of work
    rows = np.stack([np.einsum("i,ij->j", weights, square[window]) for window, weights in windows])
    total = np.stack([np.einsum("ij,j->i", rows[:, window], weights) for window, weights in windows], axis=1)
    one = image.full_scale << 2 * _WEIGHT_BITS
    rounded = (total.astype(np.int64) * (2 * 255) + one) // (2 * one)
    return VisualContext.from_bytes(rounded.astype(np.uint8).tobytes())


def _levels(image: Image.Image) -> Levels:
    """Return one grey channel of a decoded picture, in bands of rows, so that copies of it take little memory."""
    width, height = image.size
    rows = max(1, _BAND_PIXELS // width)
    levels = np.empty((height, width), dtype=np.uint16 if image.mode.startswith("I;16") else np.uint8)
    for top in range(0, height, rows):
        bottom = min(height, top + rows)
        levels[top:bottom] = _band_levels(image.crop((0, top, width, bottom)))
    return levels


def _band_levels(image: Image.Image) -> Levels:
    """Return one grey channel of some rows, by the rules at the top of this module."""
    if image.mode.startswith("I;16"):
        levels = np.array(image).astype(np.uint16)
        levels[levels == image.info.get("transparency", -1)] = 0
        return levels
    if image.has_transparency_data:
        image = image.convert("RGBA")
        grey = Image.new("L", image.size, round(BACKGROUND_LEVEL * 255))
        grey.paste(image.convert("L"), mask=image.getchannel("A"))
        return np.asarray(grey)
    if image.mode not in ("1", "L", "RGB"):
        image = image.convert("RGB")
    return np.asarray(image.convert("L"))


def _upright_colour(image: Image.Image) -> ColourImage:
    levels, width, height, factor = _colour_levels(image)
    orientation = _orientation(image)
    if orientation in (5, 6, 7, 8):
        width, height = height, width
    return ColourImage(np.ascontiguousarray(_upright(levels, orientation)), width, height, factor)


def _colour_levels(image: Image.Image) -> tuple[npt.NDArray[np.uint8], int, int, int]:
    """Return red, green, blue and alpha of a decoded picture, its width and height, and the factor of its reduction."""
    width, height = image.size
    factor = -(-max(width, height) // LARGEST_COLOUR_SIDE)
    rows = max(1, _BAND_PIXELS // (width * factor)) * factor
    levels = np.empty((-(-height // factor), -(-width // factor), 4), dtype=np.uint8)
    for top in range(0, height, rows):
        band = image.crop((0, top, width, min(height, top + rows)))
        if band.mode.startswith("I;16"):
            band = Image.fromarray((_band_levels(band) >> 8).astype(np.uint8))
        found = np.asarray(band.convert("RGBA").reduce(factor))
        levels[top // factor : top // factor + len(found)] = found
    return levels, width, height, factor


def _orientation(image: Image.Image) -> object:
    """Return the orientation that Pillow finds in EXIF, XMP or text. Metadata that it cannot read has none."""
    try:
        return image.getexif().get(ExifTags.Base.Orientation, 1)
    except Exception:  # the parser of TIFF raises errors of any class
        return 1


def _upright(levels: npt.NDArray[Any], orientation: object) -> npt.NDArray[Any]:
    """Undo the EXIF orientation (EXIF 3.0, tag 0x0112), so that row 0 and column 0 are those of the scene."""
    if orientation in (5, 6, 7, 8):
        levels = levels.swapaxes(0, 1)
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
    """Return, for each of 32 cells along an axis, its pixels and their weights in units of 2**-18, which sum to one."""
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
    """Mirror pixels beyond the border into the picture. The pixel at the border is not repeated."""
    period = max(1, 2 * (side - 1))
    index = index % period
    return np.minimum(index, period - index)
