"""Planes: filters on images of float32, and segmentation by total variation."""

import math
from typing import Final

import numpy as np
import numpy.typing as npt
from PIL import Image, ImageDraw, ImageFilter

Plane = npt.NDArray[np.float32]
Mask = npt.NDArray[np.bool_]
_GAUSSIAN_REACH: Final = 3.0  # standard deviations
_STEP: Final = np.float32(1.0 / math.sqrt(8.0))  # of the primal-dual method: the norm of the gradient is sqrt(8)


def blurred(plane: Plane, sigma: float) -> Plane:
    """Blur a plane [h, w] or channels [h, w, k] with a Gaussian. The border is mirrored."""
    reach = max(1, min(int(_GAUSSIAN_REACH * sigma + 0.5), *(side - 1 for side in plane.shape[:2])))
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma) ** 2).astype(np.float32)
    kernel /= kernel.sum()
    for axis in (0, 1):
        widths = [(reach, reach) if axis == along else (0, 0) for along in range(plane.ndim)]
        framed = np.pad(plane, widths, mode="reflect")
        length = plane.shape[axis]
        plane = np.zeros_like(plane)
        for shift, weight in enumerate(kernel):
            plane += weight * (framed[shift : shift + length] if axis == 0 else framed[:, shift : shift + length])
    return plane


def grown(mask: Mask, pixels: int) -> Mask:
    """Grow a mask by a square of that many pixels around each of its own, or shrink it by a negative number."""
    if pixels == 0:
        return mask
    kind = ImageFilter.MaxFilter if pixels > 0 else ImageFilter.MinFilter
    image = Image.fromarray(mask.astype(np.uint8) * np.uint8(255))
    return np.asarray(image.filter(kind(2 * abs(pixels) + 1))) > 0


def filled(boundary: npt.NDArray[np.float64], shape: tuple[int, int]) -> Mask:
    """Return the pixels [h, w] inside of a boundary (n, 2)."""
    image = Image.new("L", (shape[1], shape[0]))
    whole = np.rint(boundary - 0.5).astype(int)  # Pillow would cut off fractions
    ImageDraw.Draw(image).polygon([(x, y) for x, y in whole.tolist()], fill=255)
    return np.asarray(image) > 0


def reduced(levels: npt.NDArray[np.uint8], side: int) -> npt.NDArray[np.uint8]:
    """Return colours [h, w, 3] whose longer side has at most ``side`` pixels, by the mean of pixels."""
    height, width = levels.shape[:2]
    factor = max(height, width) / side
    if factor <= 1.0:
        return levels
    size = max(1, round(width / factor)), max(1, round(height / factor))
    return np.asarray(Image.fromarray(levels).resize(size, Image.Resampling.BOX))


def resized(levels: npt.NDArray[np.uint8], side: int) -> npt.NDArray[np.uint8]:
    """Return colours [h, w, 3] whose longer side has ``side`` pixels, or less where that would be over 3 times more."""
    height, width = levels.shape[:2]
    factor = min(side / max(height, width), 3.0)
    if factor <= 1.0:
        return reduced(levels, side)
    size = round(width * factor), round(height * factor)
    return np.asarray(Image.fromarray(levels).resize(size, Image.Resampling.BICUBIC))


def least_variation(cost: Plane, boundary: Plane, rounds: int) -> Plane:
    """Return the regions u in [0, 1] that minimise the sum of cost * u plus the boundary's cost times its length.

    A convex relaxation, so no start matters (Chan, Esedoglu, Nikolova 2006), solved by the primal-dual method of
    Chambolle and Pock (2011).

    Args:
        cost: (h, w) of a pixel inside, negative where it should be.
        boundary: (h, w) cost of a unit of length of the boundary there.
        rounds: steps of the method.
    """
    inside = (cost < 0.0).astype(np.float32)
    ahead = inside
    across, down = np.zeros_like(cost), np.zeros_like(cost)
    step_cost = _STEP * cost
    for _ in range(rounds):
        across[:, :-1] += _STEP * (ahead[:, 1:] - ahead[:, :-1])
        down[:-1] += _STEP * (ahead[1:] - ahead[:-1])
        length = np.maximum(np.float32(1.0), np.sqrt(across * across + down * down) / boundary)
        across /= length
        down /= length
        divergence = across + down
        divergence[:, 1:] -= across[:, :-1]
        divergence[1:] -= down[:-1]
        following = np.clip(inside + _STEP * divergence - step_cost, np.float32(0.0), np.float32(1.0))
        ahead = np.float32(2.0) * following - inside
        inside = following
    return inside
