"""Planes: filters beside scipy's, and segmentation by total variation."""

import numpy as np
import pytest
from scipy import ndimage

from service.silhouettes.planes import blurred, filled, grown, least_variation, reduced, resized


@pytest.mark.parametrize(("shape", "sigma"), [((40, 30), 0.7), ((40, 30, 3), 3.0), ((25, 60, 2), 1.5)])
def test_a_blur_is_that_of_scipy(shape: tuple[int, ...], sigma: float) -> None:
    """A plane and one of channels are blurred as scipy does with a mirrored border."""
    plane = np.random.default_rng(0).random(shape).astype(np.float32)
    expected = ndimage.gaussian_filter(plane, sigma, axes=(0, 1), mode="mirror", truncate=3.0)
    assert blurred(plane, sigma) == pytest.approx(expected, abs=1e-5)


def test_a_blur_wider_than_the_plane_keeps_a_constant() -> None:
    """A plane of 3 x 4 pixels survives a blur of 10 pixels."""
    assert blurred(np.full((3, 4), 0.25, dtype=np.float32), 10.0) == pytest.approx(np.full((3, 4), 0.25))


@pytest.mark.parametrize("pixels", [-3, -1, 0, 1, 4])
def test_growing_is_dilation_and_shrinking_erosion(pixels: int) -> None:
    """Growth by squares is that of scipy away from the border."""
    mask = np.pad(np.random.default_rng(1).random((30, 40)) > (0.05 if pixels < 0 else 0.95), 6, mode="edge")
    square = np.ones((2 * abs(pixels) + 1,) * 2, dtype=bool)
    change = ndimage.binary_dilation if pixels >= 0 else ndimage.binary_erosion
    expected = change(mask, square)
    inner = slice(6, -6)
    assert (grown(mask, pixels)[inner, inner] == expected[inner, inner]).all()


def test_a_boundary_is_filled_between_its_pixels() -> None:
    """A box covers its pixels and at most a row more on each side, and a boundary beyond the plane is cut off."""
    box = np.array([[10.0, 5.0], [20.0, 5.0], [20.0, 9.0], [10.0, 9.0]])
    mask = filled(box, (30, 40))
    assert mask[6:8, 11:19].all()
    mask[4:10, 9:21] = False
    assert not mask.any()
    assert filled(box * 100.0 - 1000.0, (30, 40)).shape == (30, 40)


def test_a_picture_is_reduced_by_means_and_never_enlarged_by_it() -> None:
    """Sides are halved with the mean of four pixels, a small picture stays, and a line of pixels keeps one."""
    levels = np.random.default_rng(2).integers(0, 256, (40, 60, 3), dtype=np.uint8)
    half = reduced(levels, 30)
    assert half.shape == (20, 30, 3)
    assert half.astype(int) == pytest.approx(levels.reshape(20, 2, 30, 2, 3).mean(axis=(1, 3)), abs=1.0)
    assert reduced(levels, 60) is levels
    assert reduced(np.zeros((2, 5000, 3), dtype=np.uint8), 100).shape == (1, 100, 3)


@pytest.mark.parametrize(("side", "width"), [(30, 30), (90, 90), (1000, 180)])
def test_a_picture_is_resized_up_to_three_times(side: int, width: int) -> None:
    """The longer side gets the pixels that are asked for, but at most three for each of its own."""
    levels = np.full((40, 60, 3), 77, dtype=np.uint8)
    larger = resized(levels, side)
    assert larger.shape[1] == width
    assert (larger == 77).all()


def test_least_variation_drops_specks_and_keeps_a_disc() -> None:
    """Single pixels that ask to be inside are not worth their boundary, and a disc with noise is whole."""
    rng = np.random.default_rng(3)
    y, x = np.mgrid[:60, :60]
    disc = (x - 30) ** 2 + (y - 30) ** 2 < 15**2
    cost = np.where(disc, -1.0, 1.0).astype(np.float32)
    cost[rng.random(cost.shape) < 0.1] *= -1.0
    inside = least_variation(cost, np.ones_like(cost), 150) > 0.5
    assert (inside != disc).mean() < 0.01


@pytest.mark.parametrize("cost", [-1.0, 0.5])
def test_least_variation_of_one_cost_is_all_or_none(cost: float) -> None:
    """Without any contrast the plane is all inside or all outside."""
    plane = least_variation(np.full((20, 30), cost, dtype=np.float32), np.ones((20, 30), dtype=np.float32), 50)
    assert plane == pytest.approx(np.full((20, 30), float(cost < 0.0)), abs=1e-3)
