"""Tables: uneven light is divided out, and the object does not bend the table."""

import numpy as np
import pytest

from service.silhouettes.tables import light_ratios


def lit_table(size: tuple[int, int] = (80, 120)) -> np.ndarray:
    """Draw a table [h, w, 3] of 0 to 1 whose light falls off to one side."""
    y, x = np.mgrid[-1.0 : 1.0 : size[0] * 1j, -1.0 : 1.0 : size[1] * 1j]
    light = 0.75 - 0.25 * x - 0.1 * y**2
    return np.asarray(light[..., None] * (0.8, 0.6, 0.4))


def eight_bits(scene: np.ndarray) -> np.ndarray:
    """Return levels of 8 bits with sensor noise of 1 %."""
    noise = np.random.default_rng(0).normal(0.0, 0.01, scene.shape)
    return np.clip((scene + noise) * 255.0 + 0.5, 0, 255).astype(np.uint8)


def test_an_empty_table_has_ratios_of_one_in_uneven_light() -> None:
    """Nearly all pixels look like the table, and their ratios are 1 to within the noise."""
    ratios, alike = light_ratios(eight_bits(lit_table()), np.ones((80, 120), dtype=np.float32), 4)
    assert alike.mean() > 0.95
    assert ratios.mean(axis=(0, 1)) == pytest.approx([1.0, 1.0, 1.0], abs=0.005)
    assert float(ratios.std()) < 0.04


def test_an_object_is_left_out_of_the_fit() -> None:
    """Under a black object the table is the one that would be there: the rest keeps its ratio of 1."""
    scene = lit_table()
    scene[25:60, 40:90] = 0.05
    weights = np.ones((80, 120), dtype=np.float32)
    weights[15:70, 20:100] = 0.25  # the border is likelier to be the table
    ratios, alike = light_ratios(eight_bits(scene), weights, 4)
    assert not alike[25:60, 40:90].any()
    assert ratios[:20].mean() == pytest.approx(1.0, abs=0.02)
    assert ratios[30:55, 45:85].mean() < 0.4


def test_a_shadow_is_darker_alike_in_all_channels() -> None:
    """In ratios a shadow has no hue, though the table has one."""
    scene = lit_table()
    scene[30:50, 30:60] *= 0.6
    ratios, _ = light_ratios(eight_bits(scene), np.ones((80, 120), dtype=np.float32), 4)
    shadow = ratios[32:48, 32:58].mean(axis=(0, 1))
    assert shadow.max() < 0.75
    assert np.ptp(shadow) < 0.06


@pytest.mark.parametrize("level", [0, 255])
@pytest.mark.parametrize("size", [(1, 1), (2, 300), (40, 40)])
def test_black_white_and_tiny_pictures_give_finite_ratios(level: int, size: tuple[int, int]) -> None:
    """Neither a black table nor one of a pixel divides by zero."""
    ratios, alike = light_ratios(np.full((*size, 3), level, dtype=np.uint8), np.ones(size, dtype=np.float32), 4)
    assert np.isfinite(ratios).all()
    assert alike.shape == size
