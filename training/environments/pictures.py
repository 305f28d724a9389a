"""Top-down pictures of the table: the object, the goal, and a push."""

from dataclasses import dataclass
from typing import Final, Self

import numpy as np
import numpy.typing as npt
from PIL import Image, ImageDraw

from service.planning.particles import moved
from service.pushing.outlines import Outline
from service.pushing.poses import DoubleArray

PIXELS: Final = 400
_FINE: Final = 2  # pixels that are drawn for each, along each axis
_MARGIN_M: Final = 0.08
_TABLE, _OBJECT, _AXIS, _GOAL, _TIP = (250, 249, 246), (120, 132, 150), (40, 48, 60), (46, 140, 87), (200, 60, 40)


@dataclass(frozen=True)
class View:
    """Part of the table that a picture shows: a square in the world. x points right, and y points up."""

    x_m: float
    y_m: float
    half_width_m: float

    @classmethod
    def of(cls, outline: Outline, *poses: DoubleArray) -> Self:
        """Return the view that shows an outline at some poses, with room for pushes around it."""
        points = np.concatenate([_placed(outline.corners, pose) for pose in poses])
        low, high = points.min(axis=0), points.max(axis=0)
        x_m, y_m = (low + high) / 2.0
        return cls(float(x_m), float(y_m), float((high - low).max()) / 2.0 + _MARGIN_M)

    def pixels(self, points_m: DoubleArray) -> list[tuple[float, float]]:
        """Return the places of points (n, 2) of the world in a fine picture."""
        scale = _FINE * PIXELS / (2.0 * self.half_width_m)
        x = (points_m[:, 0] - self.x_m + self.half_width_m) * scale
        y = (self.y_m + self.half_width_m - points_m[:, 1]) * scale
        return list(zip(x.tolist(), y.tolist(), strict=True))


def draw_table(
    view: View, outline: Outline, pose: DoubleArray, goal: DoubleArray, push: DoubleArray | None, radius_m: float
) -> npt.NDArray[np.uint8]:
    """Draw the table, (400, 400, 3).

    Args:
        view: part of the table.
        outline: the object.
        pose: (3,) of the object in the world. A line leads from its origin along its x axis.
        goal: (3,) drawn as an outline.
        push: (4,) x_m, y_m, angle_rad, length_m: the way of the tip, and the tip at its end. None: no push.
        radius_m: of the tip.
    """
    picture = Image.new("RGB", (_FINE * PIXELS, _FINE * PIXELS), _TABLE)
    draw = ImageDraw.Draw(picture)
    axis = np.array([(0.0, 0.0), (outline.size_m, 0.0)])
    draw.polygon(view.pixels(_placed(outline.corners, pose)), fill=_OBJECT)
    draw.line(view.pixels(_placed(axis, pose)), fill=_AXIS, width=2 * _FINE)
    ring = _placed(outline.corners, goal)
    draw.line(view.pixels(np.concatenate([ring, ring[:1]])), fill=_GOAL, width=2 * _FINE)
    draw.line(view.pixels(_placed(axis, goal)), fill=_GOAL, width=2 * _FINE)
    if push is not None:
        way = _placed(np.array([(0.0, 0.0), (push[3], 0.0)]), push[:3])
        (x, y), radius = view.pixels(way)[1], radius_m * _FINE * PIXELS / (2.0 * view.half_width_m)
        draw.line(view.pixels(way), fill=_TIP, width=_FINE)
        draw.ellipse((x - radius, y - radius, x + radius, y + radius), fill=_TIP)
    return np.asarray(picture.reduce(_FINE))


def _placed(points_m: DoubleArray, pose: DoubleArray) -> DoubleArray:
    """Return points (n, 2) of an object at a pose (3,)."""
    poses = np.column_stack([points_m, np.zeros(len(points_m))])
    return moved(np.broadcast_to(pose, poses.shape), poses)[:, :2]
