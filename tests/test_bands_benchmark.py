"""Coverage by band of the models of Omnipush's objects: the figures of their goals."""

import numpy as np
import pytest

from benchmarks.bands import coverage_rows, summary
from training.fitting.bands import CAMERA
from training.fitting.evaluation import Predictions
from training.omnipush.published import published_normalisation


def predicted(error: float, std: float) -> Predictions:
    """Return 200 pushes at the centre that miss by ``error``: half of them from 70 mm, half from 100 mm.

    The deviation is ``std`` at 70 mm and 1 at 100 mm.
    """
    known = published_normalisation()
    near = np.arange(200) % 2 == 0
    pushers = np.column_stack([np.where(near, -0.07, -0.1), np.zeros(200), np.zeros(200)])
    inputs = ((pushers - known.input_mean) / known.input_std).astype(np.float32)
    zeros = np.zeros((200, 3), dtype=np.float32)
    log_std = np.where(near[:, None], np.log(std), 0.0).astype(np.float32) + zeros
    return Predictions(zeros, log_std, zeros + np.float32(error), inputs, np.arange(200) // 2, (1.0, 1.0, 1.0))


def test_the_worst_bands_are_the_figures_of_the_goals() -> None:
    """Intervals at 70 mm are too narrow by far and hold none, those at 100 mm hold all, and the aims half."""
    found = summary("push-none", {"": predicted(0.5, 0.1)})
    assert found == {"push-none_low": 0.0, "push-none_high": 100.0}


def test_camera_views_are_compared_with_drawings() -> None:
    """The error on camera views is put over that on drawings, and their bands count too."""
    found = summary("push-visual", {"": predicted(0.5, 1.0), CAMERA: predicted(0.6, 0.1)})
    assert found["camera"] == pytest.approx(1.2)
    assert (found["push-visual_low"], found["push-visual_high"]) == (0.0, 100.0)


def test_a_row_has_the_figures_of_its_band() -> None:
    """The table has all pushes first, then each ring and band that has pushes."""
    rows = coverage_rows("push-none 2", predicted(0.5, 0.1))
    assert [row.split(" | ")[1:3] for row in rows] == [
        ["all pushes", "200"],
        ["start 60 to 75 mm", "100"],
        ["start 90 to 105 mm", "100"],
        ["aim 0 to 12 mm", "200"],
    ]
    assert rows[0].endswith("| 50.0 | 50.0 | 50.0 |")
    assert rows[1].endswith("| 0.0 | 0.0 | 0.0 |")
