"""Search for outlines: masks exactly, photographs by segmentation, and refusals with their cures."""

import numpy as np
import numpy.typing as npt
import pytest
from PIL import Image, ImageDraw

from service.errors import InvalidImageError, InvalidRequestError
from service.pushing.image_quality import QualityFlag
from service.pushing.images import LARGEST_COLOUR_SIDE, ColourImage
from service.silhouettes.search import find_outline

Levels = npt.NDArray[np.uint8]
Box = tuple[int, int, int, int]  # left, top, right, bottom, between pixels
L_SHAPE: tuple[Box, ...] = ((60, 40, 220, 90), (60, 40, 110, 200))
L_CORNERS = ((60, 40), (220, 40), (220, 90), (110, 90), (110, 200), (60, 200))


def mask_of(*boxes: Box, size: tuple[int, int] = (320, 240)) -> Levels:
    """Draw boxes in white on black."""
    mask = np.zeros(size[::-1], dtype=np.uint8)
    for left, top, right, bottom in boxes:
        mask[top:bottom, left:right] = 255
    return mask


def test_a_mask_is_traced_to_half_a_pixel_in_the_frame_of_its_middle() -> None:
    """An L of a mask has its corners where they were drawn: x right, y up, in metres from the picture's middle."""
    found = find_outline(ColourImage.from_array(mask_of(*L_SHAPE)), 0.001)
    assert found.flags == ()
    for x, y in L_CORNERS:
        place = np.array([[(x - 160.0) * 0.001, (120.0 - y) * 0.001]])
        assert abs(found.outline.distance_m(place)[0]) < 0.0005
    assert found.outline.area_m2 == pytest.approx((160 * 50 + 50 * 110) * 1e-6, rel=0.02)
    assert len(found.outline.corners) < 30


@pytest.mark.parametrize("form", ["white on black", "black on white", "alpha", "two grey levels"])
def test_every_form_of_a_mask_gives_the_same_outline(form: str) -> None:
    """White on black, black on white, opaque on transparent and two close grey levels mean the same object."""
    mask = mask_of(*L_SHAPE)
    alpha = np.dstack([np.random.default_rng(0).integers(0, 256, (*mask.shape, 3), dtype=np.uint8), mask])
    levels = {"white on black": mask, "black on white": 255 - mask, "alpha": alpha, "two grey levels": mask // 255 + 7}
    found = find_outline(ColourImage.from_array(levels[form].astype(np.uint8)), 0.001)
    expected = find_outline(ColourImage.from_array(mask), 0.001)
    assert found.outline.corners == pytest.approx(expected.outline.corners, abs=1e-5)


def test_a_hole_is_filled() -> None:
    """A ring becomes a disc: the outline is the outer one."""
    image = Image.new("L", (200, 200))
    ImageDraw.Draw(image).ellipse((40, 40, 160, 160), fill=255)
    ImageDraw.Draw(image).ellipse((70, 70, 130, 130), fill=0)
    found = find_outline(ColourImage.from_array(np.asarray(image)), 0.001)
    assert found.outline.area_m2 == pytest.approx(np.pi * 0.0605**2, rel=0.01)


def test_a_large_mask_keeps_its_scale() -> None:
    """A picture that is reduced gives metres of the picture as it was sent."""
    size = (2 * LARGEST_COLOUR_SIDE + 1, 1000)
    picture = ColourImage.from_array(mask_of((1000, 200, 3000, 800), size=size))
    assert picture.factor == 3
    corners = find_outline(picture, 1e-4).outline.corners
    assert corners.min(axis=0) == pytest.approx([(1000 - size[0] / 2) * 1e-4, -0.03], abs=2e-4)
    assert corners.max(axis=0) == pytest.approx([(3000 - size[0] / 2) * 1e-4, 0.03], abs=2e-4)


@pytest.mark.parametrize(
    ("levels", "code"),
    [
        (np.zeros((50, 60), dtype=np.uint8), "image_blank"),
        (np.full((1, 1), 128, dtype=np.uint8), "image_blank"),
        (np.zeros((50, 60, 4), dtype=np.uint8), "image_blank"),
        (mask_of(*L_SHAPE)[:, 60:], "image_clipped"),
        (mask_of(*L_SHAPE, (240, 30, 300, 230)), "image_several_objects"),
    ],
)
def test_a_picture_without_a_single_silhouette_is_refused(levels: Levels, code: str) -> None:
    """The refusal names the field and the cause."""
    with pytest.raises(InvalidImageError, match=f"^body.image: received .*{code}.* accepted is ") as caught:
        find_outline(ColourImage.from_array(levels), 0.001, ("body.image", "body.metres_per_pixel"))
    assert caught.value.status == 422


def test_a_boundary_that_folds_over_the_whole_picture_is_refused() -> None:
    """A comb of 508 teeth in a picture of 2048 x 2048 would take a minute to simplify: it is no single silhouette."""
    comb = mask_of((4, 4, 2044, 2044), size=(2048, 2048))
    for left in range(8, 2040, 4):
        comb[12:, left : left + 2] = 0
    with pytest.raises(InvalidImageError, match="no single silhouette"):
        find_outline(ColourImage.from_array(comb), 0.0001)


def test_a_small_second_object_is_flagged() -> None:
    """Crumbs beside the object leave an answer, with a flag."""
    picture = ColourImage.from_array(mask_of(*L_SHAPE, (240, 150, 260, 175)))
    assert find_outline(picture, 0.001).flags == (QualityFlag.SEVERAL_OBJECTS,)


@pytest.mark.parametrize("scale", [1e-6, 1.0, 0.0, -0.001, float("nan"), float("inf")])
def test_a_scale_that_gives_an_impossible_size_is_refused(scale: float) -> None:
    """Objects under 5 mm or over 2 m, and scales that are not positive, name the field of the scale."""
    with pytest.raises(InvalidRequestError, match=r"^metres_per_pixel: received .* accepted is "):
        find_outline(ColourImage.from_array(mask_of(*L_SHAPE)), scale)
