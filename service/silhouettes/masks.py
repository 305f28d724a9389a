"""Masks: pictures that already tell the object from the rest, by alpha or in black and white."""

from typing import Final

import numpy as np
import numpy.typing as npt

from service.pushing.images import ColourImage

Plane = npt.NDArray[np.float32]
OPAQUE: Final = 128  # alpha from which a pixel belongs to the object
NEAR: Final = 32  # levels: as near as this to black or white counts as such
LARGEST_GREY_SHARE: Final = 0.02  # of a black and white mask: smoothed edges, and rings of JPEG
LARGEST_CHROMA: Final = 24  # levels between channels of a black and white mask


def mask_coverage(picture: ColourImage) -> Plane | None:
    """Return the share of each pixel that the object covers, [rows, columns], or None if the picture is no mask.

    A picture with transparent pixels is a mask of its opaque ones. Black and white, or any two grey levels, is a mask
    of the one that the border shows less of.
    """
    alpha = picture.levels[..., 3]
    if alpha.min() < OPAQUE:
        return alpha.astype(np.float32) / np.float32(255.0)
    colours = picture.levels[..., :3]
    low, high = colours.min(axis=2), colours.max(axis=2)
    if int((high - low).max()) > LARGEST_CHROMA:
        return None
    grey = colours[..., 1]
    counts = np.bincount(grey.ravel(), minlength=256)
    used = np.flatnonzero(counts)
    between = counts[NEAR : 256 - NEAR].sum()
    two_levels = len(used) == 2
    if not two_levels and (between > LARGEST_GREY_SHARE * grey.size or used[0] >= NEAR or used[-1] < 256 - NEAR):
        return None
    coverage = (grey.astype(np.float32) - used[0]) / np.float32(used[-1] - used[0])
    border = np.concatenate([coverage[0], coverage[-1], coverage[:, 0], coverage[:, -1]])
    return np.asarray(np.float32(1.0) - coverage) if border.mean() > 0.5 else coverage
