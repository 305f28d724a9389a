"""Random outlines: valid, of the stated sizes, and the same for the same seed."""

import hashlib

import numpy as np
import pytest

from service.pushing.outlines import MOST_CORNERS, Outline
from training.shapes.families import FAMILIES
from training.shapes.outlines import LEAST_WIDTH_M, ORIGIN_SHARE, SIZES_M, TOLERANCES_M, draw_outline

SEEDS = 60
ROUNDING_M = 2.0 * TOLERANCES_M[1]  # of a size, by the corners that are left out


def outlines(family: str, count: int) -> list[Outline]:
    """Return outlines of a family with the seeds from 0 on."""
    return [draw_outline(family, np.random.default_rng([seed, *family.encode()])) for seed in range(count)]


@pytest.mark.parametrize("family", FAMILIES)
def test_outlines_are_valid_and_of_the_stated_sizes(family: str) -> None:
    """Every outline of 60 is a simple polygon of 20 to 300 mm with few corners, and is not a line."""
    found = outlines(family, SEEDS)  # each passed the checks of ``Outline.of``

    sizes = np.array([outline.extent_m for outline in found])
    assert (sizes > SIZES_M[0] - ROUNDING_M).all()
    assert (sizes < SIZES_M[1] + ROUNDING_M).all()
    assert np.percentile(sizes, 10) < 0.06
    assert np.percentile(sizes, 90) > 0.15
    assert max(len(outline.corners) for outline in found) <= MOST_CORNERS / 4
    assert min(outline.area_m2 / outline.extent_m for outline in found) > LEAST_WIDTH_M / 4


@pytest.mark.parametrize("family", FAMILIES)
def test_outlines_differ_from_each_other(family: str) -> None:
    """The proportions of a family are drawn too: area over the square of the size takes many values."""
    shares = {round(outline.area_m2 / outline.extent_m**2, 3) for outline in outlines(family, 40)}

    assert len(shares) >= 5


def test_the_origin_is_near_the_centroid_and_not_on_it() -> None:
    """The origin is off the centroid, by up to a tenth of the size along each axis."""
    found = outlines("mug", 60)

    offsets = np.array([outline.centroid_m / outline.extent_m for outline in found])
    assert (np.abs(offsets) < 1.05 * ORIGIN_SHARE).all()
    assert np.abs(offsets).max() > 0.8 * ORIGIN_SHARE
    assert np.abs(offsets.mean(axis=0)).max() < 0.3 * ORIGIN_SHARE


def test_outlines_have_any_orientation() -> None:
    """The long axis of bars takes all directions."""
    angles = []
    for outline in outlines("bar", 60):
        _, vectors = np.linalg.eigh(np.cov((outline.corners - outline.corners.mean(axis=0)).T))
        angles.append(np.arctan2(vectors[1, -1], vectors[0, -1]) % np.pi)

    assert np.histogram(angles, bins=4, range=(0.0, np.pi))[0].min() >= 5


def test_corners_lie_on_a_grid_of_a_micrometre() -> None:
    """Last digits, in which processors differ, are rounded away."""
    for family in FAMILIES:
        for outline in outlines(family, 3):
            micrometres = 1e6 * outline.corners
            assert np.abs(micrometres - np.round(micrometres)).max() < 1e-6


def test_outlines_depend_on_the_seed_alone() -> None:
    """These bytes are the same with AVX-512, and without it, AVX2 and FMA."""
    content = b"".join(outline.corners.tobytes() for family in FAMILIES for outline in outlines(family, 3))

    assert hashlib.sha256(content).hexdigest() == "a1cae11521987e5fec2c56f111b4785590495e0dd8c7867b7d8e7368ff58d65c"
