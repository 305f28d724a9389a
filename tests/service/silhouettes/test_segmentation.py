"""Segmentation of photographs: drawn objects are found to 0.9 of their union, and stains are not."""

import numpy as np
import numpy.typing as npt
import pytest
from PIL import Image, ImageFilter

from service.silhouettes.planes import filled
from service.silhouettes.segmentation import LEAST_SIDE, segment

Levels = npt.NDArray[np.uint8]
Mask = npt.NDArray[np.bool_]
SIZE = (300, 400)
TABLE = (0.55, 0.45, 0.35)


def box(left: int = 150, top: int = 120, width: int = 90, height: int = 60) -> Mask:
    """Return the mask of a box in a picture of 400 x 300."""
    mask = np.zeros(SIZE, dtype=bool)
    mask[top : top + height, left : left + width] = True
    return mask


def picture(mask: Mask, colour: tuple[float, float, float], light: float = 0.0, shadow: float = 0.0) -> Levels:
    """Draw an object on a table.

    Args:
        mask: of the object.
        colour: of the object, 0 to 1.
        light: share of the light that is lost from left to right.
        shadow: share of the light that is lost in a shadow of 8 pixels at the right and below.
    """
    scene = np.empty((*SIZE, 3))
    scene[:] = TABLE
    scene *= 1.0 - shadow * np.roll(mask, (8, 8), axis=(0, 1))[..., None]
    scene[mask] = colour
    scene *= np.linspace(1.0, 1.0 - light, SIZE[1])[None, :, None]
    blurred = Image.fromarray((scene * 255.0).astype(np.uint8)).filter(ImageFilter.GaussianBlur(1.0))
    noise = np.random.default_rng(0).normal(0.0, 3.0, scene.shape)
    return np.clip(np.asarray(blurred) + noise, 0, 255).astype(np.uint8)


def overlap(levels: Levels, mask: Mask) -> float:
    """Return the intersection over union of the first region with a mask."""
    fine = filled(4.0 * segment(levels)[0].boundary, (4 * SIZE[0], 4 * SIZE[1]))
    found = fine.reshape(SIZE[0], 4, SIZE[1], 4).mean(axis=(1, 3)) > 0.5
    return float((found & mask).sum() / (found | mask).sum())


@pytest.mark.parametrize(
    ("colour", "light", "shadow"),
    [
        ((0.1, 0.1, 0.12), 0.0, 0.0),
        ((0.95, 0.9, 0.9), 0.5, 0.0),
        ((0.2, 0.3, 0.8), 0.3, 0.35),
        ((0.85, 0.85, 0.2), 0.0, 0.5),
    ],
    ids=["darker", "lighter in uneven light", "blue with a shadow", "yellow with a deep shadow"],
)
def test_a_box_is_found_without_its_shadow(colour: tuple[float, float, float], light: float, shadow: float) -> None:
    """Darker and lighter boxes, in uneven light and with hard shadows, are found to 0.93 of the union."""
    assert overlap(picture(box(), colour, light, shadow), box()) > 0.93


@pytest.mark.parametrize(("width", "height"), [(24, 12), (60, 7)])
def test_a_small_or_thin_object_keeps_its_width(width: int, height: int) -> None:
    """A box of 24 x 12 pixels and a bar of 7 pixels are found to 0.85: less than a pixel on each side."""
    mask = box(width=width, height=height)
    assert overlap(picture(mask, (0.9, 0.2, 0.2)), mask) > 0.85


def test_two_objects_are_two_regions() -> None:
    """The second of two boxes follows the first, with its area."""
    both = box(60, 60, 80, 60) | box(250, 180, 70, 60)
    areas = [region.area for region in segment(picture(both, (0.1, 0.2, 0.5)))]
    assert len(areas) == 2
    assert min(areas) > 2500


def test_an_object_at_the_border_reaches_it() -> None:
    """A box that leaves the picture is found up to the border, so that it can be refused."""
    low = segment(picture(box(left=0), (0.1, 0.1, 0.5)))[0].boundary.min(axis=0)
    assert low[0] < 1.0


def test_a_stain_with_a_soft_edge_is_no_object() -> None:
    """Neither an empty table nor a smooth dark stain gives a region."""
    assert segment(picture(box(width=0), TABLE)) == []
    y, x = np.mgrid[: SIZE[0], : SIZE[1]]
    stain = 1.0 - 0.35 * np.exp(-((x - 200) ** 2 + (y - 150) ** 2) / (2.0 * 40.0**2))
    levels = np.clip(picture(box(width=0), TABLE) * stain[..., None], 0, 255).astype(np.uint8)
    assert segment(levels) == []


@pytest.mark.parametrize("shape", [(LEAST_SIDE - 1, 400, 3), (LEAST_SIDE, LEAST_SIDE, 3), (2, 4000, 3), (1, 1, 3)])
@pytest.mark.parametrize("kind", ["black", "noise"])
def test_tiny_and_narrow_pictures_end_without_an_error(shape: tuple[int, int, int], kind: str) -> None:
    """Pictures too small for a table, black ones and noise give regions or none, and never an exception."""
    levels = np.zeros(shape, dtype=np.uint8)
    if kind == "noise":
        levels = np.random.default_rng(1).integers(0, 256, shape, dtype=np.uint8)
    assert all(region.area > 0.0 for region in segment(levels))


def test_the_same_picture_gives_the_same_boundary() -> None:
    """Segmentation draws no random numbers."""
    levels = picture(box(), (0.2, 0.6, 0.2), 0.2, 0.2)
    first, second = (segment(levels)[0].boundary for _ in range(2))
    assert (first == second).all()
