"""Pictures of answers: an object before and after a push, the uncertainty of the answer, and the pusher's path."""

import math
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Ellipse, Wedge

from service.pushing.poses import DoubleArray

ELLIPSE_90: Final = math.sqrt(-2.0 * math.log(0.1))  # deviations: 90 % of a Gaussian in the plane
INTERVAL_90: Final = 1.6448536  # deviations: 90 % of one coordinate
_AFTER, _PUSHER, _REFUSED = "tab:blue", "tab:orange", "tab:red"
_WIDTH: Final = 52  # characters of a line under a panel
_COLUMNS: Final = 3
_PANEL_IN, _WORDS_IN = 4.2, 1.6  # width of a panel, and height of title and caption
_MARGIN: Final = 0.06  # of the widest side, around a panel


@dataclass(frozen=True, eq=False)
class Backdrop:
    """Picture under a panel, in the frame of the picture: origin in its middle, x right, y up."""

    levels: npt.NDArray[np.uint8]
    metres_per_pixel: float

    @property
    def extent_mm(self) -> tuple[float, float, float, float]:
        """Left, right, bottom and top."""
        height, width = (500.0 * self.metres_per_pixel * pixels for pixels in self.levels.shape[:2])
        return -width, width, -height, height


@dataclass(frozen=True, eq=False)
class Panel:
    """Panel of one push. Without an answer the push was refused, and the text says why.

    Attributes:
        title: of the panel.
        corners: (n, 2) m outline before the push, or None for a picture without an object.
        pusher: (4,) x_m, y_m, angle_rad, length_m, or None.
        pusher_radius_m: radius of the tip.
        mean: (3,) x_m, y_m, yaw_rad of the answer, or None.
        std: (3,).
        text: warnings, or the refusal.
    """

    title: str
    corners: DoubleArray | None
    pusher: DoubleArray | None
    pusher_radius_m: float
    mean: DoubleArray | None
    std: DoubleArray | None
    text: str


def draw_panels(path: Path, panels: Sequence[Panel], backdrop: Backdrop | None) -> None:
    """Write a PNG with a panel for each push of an object, all with the same scale."""
    left, right, bottom, top = _limits(panels, backdrop)
    columns = min(len(panels), _COLUMNS)
    rows = -(-len(panels) // columns)
    height = _PANEL_IN * (top - bottom) / (right - left) + _WORDS_IN
    figure = Figure(figsize=(_PANEL_IN * columns, height * rows), dpi=80, layout="constrained")
    for axes, panel in zip(figure.subplots(rows, columns, squeeze=False).flat, panels, strict=True):
        _draw(axes, panel, backdrop)
        axes.set(xlim=(left, right), ylim=(bottom, top), aspect="equal")
        axes.tick_params(labelsize=7)
        axes.set_title(panel.title, fontsize=10)
        axes.set_xlabel(f"x (mm)\n{_caption(panel)}", fontsize=9, color=_REFUSED if panel.mean is None else "black")
    figure.savefig(path, metadata={"Software": None})


def in_words(mean: DoubleArray, std: DoubleArray) -> tuple[str, str]:
    """Return position and yaw of an answer as texts, in mm and degrees."""
    (x, y), (dx, dy) = np.round(1e3 * mean[:2], 1) + 0.0, 1e3 * std[:2]
    yaw = round(math.degrees(mean[2]), 1) + 0.0  # without the sign of a zero
    return f"x {x:.1f} ± {dx:.1f} mm, y {y:.1f} ± {dy:.1f} mm", f"yaw {yaw:.1f} ± {math.degrees(std[2]):.1f} degrees"


def moved(corners: DoubleArray, pose: DoubleArray) -> DoubleArray:
    """Return corners (n, 2) after a motion (3,) of their frame: x_m, y_m, yaw_rad."""
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    return np.asarray(corners @ np.array([[cos, sin], [-sin, cos]]) + pose[:2])


def _draw(axes: Any, panel: Panel, backdrop: Backdrop | None) -> None:
    if backdrop is not None:
        axes.imshow(backdrop.levels, extent=backdrop.extent_mm, alpha=0.75)
    if panel.corners is not None:
        face = "0.85" if backdrop is None else "none"
        axes.fill(*(1e3 * panel.corners.T), facecolor=face, edgecolor="0.25", linewidth=1.4)
    if panel.pusher is not None:
        _draw_pusher(axes, panel.pusher, 1e3 * panel.pusher_radius_m)
    if panel.corners is not None and panel.mean is not None and panel.std is not None:
        _draw_answer(axes, panel.corners, panel.mean, panel.std)


def _draw_answer(axes: Any, corners: DoubleArray, mean: DoubleArray, std: DoubleArray) -> None:
    """Draw the outline at the mean, the frame's origin with its ellipse, and the fan of yaws, of 90 % each."""
    axes.fill(*(1e3 * moved(corners, mean).T), facecolor="none", edgecolor=_AFTER, linewidth=1.6)
    axes.plot(0.0, 0.0, "+", color="0.25", markersize=9)
    x, y = 1e3 * mean[:2]
    radius = 450.0 * float(np.ptp(corners, axis=0).max())
    half = math.degrees(INTERVAL_90 * std[2])
    yaw = math.degrees(mean[2])
    axes.add_patch(Wedge((x, y), radius, yaw - half, yaw + half, color=_AFTER, alpha=0.25, linewidth=0.0))
    axes.plot(*np.transpose([(x, y), (x + radius * math.cos(mean[2]), y + radius * math.sin(mean[2]))]), color=_AFTER)
    width, height = 2e3 * ELLIPSE_90 * std[:2]
    axes.add_patch(Ellipse((x, y), width, height, facecolor=_AFTER, edgecolor="navy", alpha=0.6))


def _draw_pusher(axes: Any, pusher: DoubleArray, radius: float) -> None:
    """Draw the tip at its start and at its end, and its path."""
    start, end = _path_mm(pusher)
    axes.add_patch(Circle(tuple(start), radius, facecolor="none", edgecolor=_PUSHER, linewidth=1.3))
    axes.add_patch(Circle(tuple(end), radius, facecolor=_PUSHER, edgecolor="none", alpha=0.8))
    axes.plot(*np.transpose([start, end]), color=_PUSHER, linewidth=1.4)


def _path_mm(pusher: DoubleArray) -> tuple[DoubleArray, DoubleArray]:
    x, y, angle, length = pusher
    start = 1e3 * np.array([x, y])
    return start, start + 1e3 * length * np.array([math.cos(angle), math.sin(angle)])


def _caption(panel: Panel) -> str:
    lines = () if panel.mean is None or panel.std is None else in_words(panel.mean, panel.std)
    return "\n".join([*lines, *textwrap.wrap(panel.text, _WIDTH)])


def _limits(panels: Sequence[Panel], backdrop: Backdrop | None) -> tuple[float, float, float, float]:
    """Return left, right, bottom and top in mm of all that panels show."""
    points = [np.zeros((1, 2))]
    for panel in panels:
        if panel.corners is not None:
            points.append(1e3 * panel.corners)
            if panel.mean is not None:
                points.append(1e3 * moved(panel.corners, panel.mean))
        if panel.pusher is not None:
            points += [np.array(_path_mm(panel.pusher)) + side * 1e3 * panel.pusher_radius_m for side in (-1.0, 1.0)]
    if backdrop is not None:
        left, right, bottom, top = backdrop.extent_mm
        points.append(np.array([(left, bottom), (right, top)]))
    everything = np.concatenate(points)
    low, high = everything.min(axis=0), everything.max(axis=0)
    margin = _MARGIN * float((high - low).max())
    return float(low[0] - margin), float(high[0] + margin), float(low[1] - margin), float(high[1] + margin)
