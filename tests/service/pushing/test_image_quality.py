"""Quality of visual contexts: flags of faults, and thumbnails."""

import numpy as np
import pytest

from service.pushing.image_quality import quality_flags, thumbnail_png
from service.pushing.images import GreyImage, decode, visual_context
from tests.service.pushing.pictures import cells, noise


def scene(*boxes: tuple[int, int, int, int], side: int = 480) -> GreyImage:
    """Return a picture of grey boxes (top, left, bottom, right) on black."""
    levels = np.zeros((side, side), dtype=np.uint8)
    for top, left, bottom, right in boxes:
        levels[top:bottom, left:right] = 128
    return GreyImage(levels)


@pytest.mark.parametrize(
    ("image", "flags"),
    [
        (scene((160, 160, 320, 320)), ()),
        (scene(), ("blank",)),
        (GreyImage(np.full((50, 50), 255, dtype=np.uint8)), ("blank",)),
        (GreyImage((noise(480, 480) // 16).astype(np.uint8)), ("blank",)),
        (scene((230, 230, 235, 235)), ("blank",)),
        (scene((0, 100, 480, 380)), ("clipped",)),
        (scene((160, 0, 320, 160)), ("clipped", "off_centre")),
        (scene((60, 60, 220, 220)), ("off_centre",)),
        (scene((180, 180, 340, 340)), ()),
        (scene((140, 60, 340, 220), (140, 260, 340, 420)), ("off_centre", "several_objects")),
        (scene((120, 120, 360, 360), (20, 20, 80, 80)), ("several_objects",)),
        (scene((120, 120, 360, 360), (20, 20, 30, 30)), ()),
        (scene((100, 100, 220, 220), (220, 220, 380, 380)), ("off_centre", "several_objects")),
    ],
    ids=[
        "middle", "black", "white", "dim noise", "a speck", "over the border", "at the side", "in a corner",
        "10 px off", "two of a size", "a second one", "a crumb", "corner to corner",
    ],
)  # fmt: skip
def test_each_fault_of_a_picture_is_flagged(image: GreyImage, flags: tuple[str, ...]) -> None:
    """A good picture has no flags, and a faulty one has its flags in a fixed order."""
    assert quality_flags(visual_context(image)) == flags


def test_the_thumbnail_shows_every_level_as_a_block() -> None:
    """The thumbnail has 256 x 256 pixels, a block of 8 x 8 for every level of the context."""
    context = visual_context(GreyImage(noise(100, 100)))
    found = decode(thumbnail_png(context)).levels
    assert found.shape == (256, 256)
    assert np.array_equal(found, np.kron(cells(context), np.ones((8, 8), dtype=np.uint8)))
