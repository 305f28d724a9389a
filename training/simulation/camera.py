"""Camera views: a clean top-down view with light, shadow, table, optics, sensor noise and JPEG.

Models trained on clean drawings fail on photographs. This module adds the differences between the two, within the
ranges below. The ranges describe a fixed, roughly calibrated camera above a lit table. They are our assumption, not
measurements. All random numbers come from the generator that is passed in, always in the same order, so that the seed
decides every pixel.
"""

import io
import math
from typing import Final

import numpy as np
import numpy.typing as npt
from PIL import Image, ImageFilter

from service.pushing.images import BODY_LEVEL, FIELD_OF_VIEW_M

View = npt.NDArray[np.uint8]
Plane = npt.NDArray[np.float64]
Range = tuple[float, float]

MISPLACEMENT_M: Final = 0.003  # offset of the object from the picture's centre, along each axis
ROTATION_RAD: Final = math.radians(4.0)
SCALE: Final = 0.03  # relative error of the camera's height
TABLE_LEVEL: Final[Range] = (0.03, 0.20)
TABLE_TEXTURE: Final[Range] = (0.01, 0.05)  # standard deviation of its grain
TEXTURE_CELLS: Final = (6, 24, 96)  # across the picture, coarse to fine
LIGHT_FALL: Final[Range] = (0.0, 0.25)  # loss of light at the side away from the lamp
VIGNETTE: Final[Range] = (0.0, 0.15)  # loss of light in the corners
SHADOW_LENGTH_M: Final[Range] = (0.0, 0.012)  # for an object 30 mm high under a lamp above
SHADOW_DEPTH: Final[Range] = (0.2, 0.7)
SHADOW_BLUR_PIXELS: Final = 6.0
EXPOSURE: Final[Range] = (0.8, 1.25)
GAMMA: Final[Range] = (0.85, 1.2)
BLUR_PIXELS: Final[Range] = (0.4, 2.5)
READ_NOISE: Final[Range] = (0.003, 0.02)  # standard deviation
SHOT_NOISE: Final[Range] = (0.0, 0.02)  # standard deviation at white, proportional to the root of the light
JPEG_QUALITY: Final = (50, 95)


def camera_view(view: View, rng: np.random.Generator) -> View:
    """Return a clean view, uint8 [n, n], as a camera would see it, uint8 of the same shape."""
    albedo = _misplaced(view, rng) / 255.0
    cover = np.minimum(albedo / BODY_LEVEL, 1.0)
    lamp_rad = rng.uniform(-math.pi, math.pi)
    table = np.clip(rng.uniform(*TABLE_LEVEL) + _texture(len(view), rng), 0.0, None) * (
        1.0 - _shadow(cover, lamp_rad, rng)
    )
    light = _light(len(view), lamp_rad, rng)
    scene = (cover * albedo + (1.0 - cover) * table) * light
    scene = np.clip(scene * rng.uniform(*EXPOSURE), 0.0, 1.0) ** rng.uniform(*GAMMA)
    return _jpeg(_sensed(_blurred(scene, rng.uniform(*BLUR_PIXELS)), rng), rng)


def _misplaced(view: View, rng: np.random.Generator) -> View:
    """Shift, turn and scale a view a little about its middle."""
    size = len(view)
    shift = rng.uniform(-MISPLACEMENT_M, MISPLACEMENT_M, 2) * size / FIELD_OF_VIEW_M
    turn_rad, scale = rng.uniform(-ROTATION_RAD, ROTATION_RAD), 1.0 + rng.uniform(-SCALE, SCALE)
    # Pillow expects the inverse: for each pixel of the result, its place in the source.
    inverse = np.array([[math.cos(turn_rad), math.sin(turn_rad)], [-math.sin(turn_rad), math.cos(turn_rad)]]) / scale
    middle = np.full(2, size / 2)
    offset = middle - inverse @ (middle + shift)
    matrix = (*inverse[0], offset[0], *inverse[1], offset[1])
    moved = Image.fromarray(view).transform((size, size), Image.Transform.AFFINE, matrix, Image.Resampling.BILINEAR)
    return np.array(moved)


def _texture(size: int, rng: np.random.Generator) -> Plane:
    """Draw grain of several sizes, [size, size], around 0."""
    grain = np.zeros((size, size))
    for cells in TEXTURE_CELLS:
        coarse = Image.fromarray(rng.normal(size=(cells, cells)).astype(np.float32))
        layer = np.array(coarse.resize((size, size), Image.Resampling.BICUBIC), dtype=np.float64)
        grain += layer / (layer.std() * math.sqrt(len(TEXTURE_CELLS)))
    return grain * rng.uniform(*TABLE_TEXTURE)


def _shadow(cover: Plane, lamp_rad: float, rng: np.random.Generator) -> Plane:
    """Return the share of light that the table loses, on the side of the object away from the lamp."""
    length = rng.uniform(*SHADOW_LENGTH_M) * len(cover) / FIELD_OF_VIEW_M
    across, down = round(-length * math.cos(lamp_rad)), round(length * math.sin(lamp_rad))
    thrown = np.roll(cover, (down, across), axis=(0, 1))  # objects keep clear of the border, so no shadow wraps around
    return _blurred(np.maximum(thrown, cover), SHADOW_BLUR_PIXELS) * rng.uniform(*SHADOW_DEPTH)


def _light(size: int, lamp_rad: float, rng: np.random.Generator) -> Plane:
    """Return the light on each pixel, at most 1: brightest towards the lamp, darker in the corners."""
    x, y = np.linspace(-1.0, 1.0, size)[None, :], np.linspace(1.0, -1.0, size)[:, None]
    away = 0.5 - 0.5 * (x * math.cos(lamp_rad) + y * math.sin(lamp_rad)) / math.sqrt(2.0)
    fall: Plane = (1.0 - rng.uniform(*LIGHT_FALL) * away) * (1.0 - rng.uniform(*VIGNETTE) * (x**2 + y**2) / 2.0)
    return fall


def _blurred(plane: Plane, radius_pixels: float) -> Plane:
    """Blur values in [0, 1] with a Gaussian."""
    image = Image.fromarray(_eight_bits(plane)).filter(ImageFilter.GaussianBlur(radius_pixels))
    return np.array(image, dtype=np.float64) / 255.0


def _sensed(light: Plane, rng: np.random.Generator) -> View:
    """Add sensor noise and quantise to 8 bits."""
    read, shot = rng.uniform(*READ_NOISE), rng.uniform(*SHOT_NOISE)
    return _eight_bits(light + rng.normal(size=light.shape) * np.sqrt(read**2 + shot**2 * light))


def _jpeg(view: View, rng: np.random.Generator) -> View:
    """Compress a view as JPEG and decode it again."""
    buffer = io.BytesIO()
    Image.fromarray(view).save(buffer, "JPEG", quality=int(rng.integers(*JPEG_QUALITY, endpoint=True)))
    return np.array(Image.open(buffer))


def _eight_bits(plane: Plane) -> View:
    return np.floor(np.clip(plane, 0.0, 1.0) * 255.0 + 0.5).astype(np.uint8)
