"""Masks: told from photographs, by alpha or by two levels."""

import numpy as np
import numpy.typing as npt
import pytest

from service.pushing.images import ColourImage
from service.silhouettes.masks import mask_coverage

Levels = npt.NDArray[np.uint8]


def square(inside: int, outside: int) -> Levels:
    """Draw a square of 20 pixels in a picture of 60, in two levels."""
    levels = np.full((60, 60), outside, dtype=np.uint8)
    levels[20:40, 20:40] = inside
    return levels


def covered(levels: Levels) -> npt.NDArray[np.bool_] | None:
    """Return the pixels that the object covers by more than half, or None for a photograph."""
    coverage = mask_coverage(ColourImage.from_array(levels))
    return None if coverage is None else coverage > 0.5


@pytest.mark.parametrize(("inside", "outside"), [(255, 0), (0, 255), (100, 101), (250, 10)])
def test_two_levels_are_a_mask_of_the_one_away_from_the_border(inside: int, outside: int) -> None:
    """Any two grey levels, near or far, mean the object that the border does not show."""
    found = covered(square(inside, outside))
    assert found is not None
    assert (found == (square(1, 0) == 1)).all()


def test_alpha_counts_before_colours() -> None:
    """A picture with transparent pixels is a mask of the opaque ones, whatever is drawn below. Half covers half."""
    rgba = np.random.default_rng(0).integers(0, 256, (60, 60, 4), dtype=np.uint8)
    rgba[..., 3] = square(255, 0)
    rgba[30, 30, 3] = 51
    coverage = mask_coverage(ColourImage.from_array(rgba))
    assert coverage is not None
    assert coverage[30, 30] == pytest.approx(0.2)
    assert (coverage[:20] == 0.0).all()


@pytest.mark.parametrize("amplitude", [0, 20])
def test_rings_of_a_jpeg_leave_a_mask_a_mask(amplitude: int) -> None:
    """Levels within 32 of black and white, as a JPEG of a mask has them, count as such."""
    noise = np.random.default_rng(1).integers(0, amplitude + 1, (60, 60))
    levels = np.abs(square(255, 0).astype(int) - noise).astype(np.uint8)
    found = covered(levels)
    assert found is not None
    assert found.sum() == 400


def test_a_photograph_is_no_mask() -> None:
    """A tint, a ramp of greys, noise, and a grey photograph without black or white are photographs."""
    rng = np.random.default_rng(2)
    tinted = np.repeat(square(255, 0)[..., None], 3, axis=2)
    tinted[25:30, 25:30, 2] = 0
    ramp = np.tile(np.linspace(0, 255, 60).astype(np.uint8), (60, 1))
    grey = np.clip(square(90, 180) + rng.normal(0.0, 4.0, (60, 60)), 0, 255).astype(np.uint8)
    for levels in (tinted, ramp, rng.integers(0, 256, (60, 60), dtype=np.uint8), grey):
        assert covered(levels) is None


@pytest.mark.parametrize("level", [0, 7, 255])
def test_a_picture_of_one_level_is_no_mask_or_an_empty_one(level: int) -> None:
    """A single level never covers anything, and divides by no zero."""
    found = covered(np.full((5, 7), level, dtype=np.uint8))
    assert found is None or not found.any()
