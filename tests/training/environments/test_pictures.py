"""Pictures of the table from above."""

import numpy as np
import numpy.typing as npt

from service.pushing.outlines import Outline
from training.environments.pictures import PIXELS, View, draw_table

SQUARE = Outline.of([(-0.04, -0.04), (0.04, -0.04), (0.04, 0.04), (-0.04, 0.04)])
START, GOAL = np.array([0.0, 0.0, 0.0]), np.array([0.2, 0.1, 0.0])
VIEW = View.of(SQUARE, START, GOAL)


def centre(pixels: npt.NDArray[np.bool_]) -> tuple[float, float]:
    """Return the place in the world, in metres, of the middle of some pixels."""
    rows, columns = np.nonzero(pixels)
    scale = 2.0 * VIEW.half_width_m / PIXELS
    x = VIEW.x_m - VIEW.half_width_m + (columns.mean() + 0.5) * scale
    return float(x), float(VIEW.y_m + VIEW.half_width_m - (rows.mean() + 0.5) * scale)


def test_the_object_the_goal_and_the_push_are_where_they_are_in_the_world() -> None:
    """The object is filled, the goal is a line around it, and the tip stands at the end of its way."""
    push = np.array([-0.1, 0.0, np.pi / 2, 0.05])
    picture = draw_table(VIEW, SQUARE, START, GOAL, push, 0.01).astype(int)

    red, green, blue = picture[..., 0], picture[..., 1], picture[..., 2]
    assert picture.shape == (PIXELS, PIXELS, 3)
    assert np.allclose(centre((blue > red + 10) & (blue > green)), (0.0, 0.0), atol=0.002)
    goal = (green > red + 60) & (green > blue + 30)
    assert np.allclose(np.array(centre(goal)), (0.2, 0.1), atol=0.006)  # the line along its x axis pulls it aside
    tip = (red > green + 100) & (np.arange(PIXELS)[:, None] < PIXELS * 0.6)
    assert np.hypot(*np.subtract(centre(tip), (-0.1, 0.05))) < 0.02


def test_a_view_has_room_for_all_poses() -> None:
    """Every corner at every pose is in the picture, as is a margin for pushes."""
    for pose in (START, GOAL):
        pixels = np.array(VIEW.pixels(SQUARE.corners + pose[:2]))
        assert pixels.min() > 0.0
        assert pixels.max() < 2 * PIXELS
