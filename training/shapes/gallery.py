"""Gallery of shapes: some draws of every family, and objects with their feet, centre of mass and one push."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from service.pushing.outlines import Outline
from training.shapes.dataset import PushedObject, ShapePlan, draw_named, push_named
from training.shapes.families import FAMILIES
from training.simulation.exact import Array, cos, sin

DRAWS: Final = 6  # outlines of each family, and as many columns
PUSHED: Final = 2  # objects of each family with a push
BLOCKS: Final = 2  # families beside each other
PUSHES: Final = 12  # of each object, among which one is chosen to show
LEAST_MOTION: Final = 0.25  # of the size: moved by the push that is shown
_CELL_IN: Final = 1.05
_ROW_IN: Final = 1.25
_BARS_MM: Final = (10, 20, 50, 100)


def draw_gallery(path: Path, families: Sequence[str] = tuple(FAMILIES), seed: int = 0) -> None:
    """Write a PNG with draws of families at a scale of their own, each with a bar, and with pushes of some of them."""
    plan = ShapePlan(objects=len(families) * (DRAWS + PUSHED), pushes=PUSHES, seed=seed, families=tuple(families))
    columns, rows = DRAWS + PUSHED, -(-len(families) // BLOCKS)
    size = (BLOCKS * columns * _CELL_IN, rows * _ROW_IN)
    figure = Figure(figsize=size, dpi=90)
    axes = figure.subplots(rows, BLOCKS * columns, squeeze=False, gridspec_kw={"wspace": 0.04, "hspace": 0.22})
    figure.subplots_adjust(0.005, 0.005, 0.995, 1.0 - 0.2 / size[1])
    for axis in axes.flat:
        axis.axis("off")
    for place, family in enumerate(families):
        row, first = place % rows, place // rows * columns
        for number in range(columns):
            axis = axes[row, first + number]
            if number < DRAWS:
                _show(axis, draw_named(plan, family, number)[0].outline)
            else:
                _show_push(axis, plan, family, number)
        axes[row, first].set_title(family, fontsize=9, loc="left", pad=2.0, fontweight="bold")
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, metadata={"Software": None})  # without a version, so that equal images are equal files


def _show(axis: Any, outline: Outline) -> None:
    """Draw an outline with a bar of 10 to 100 mm."""
    axis.fill(*(1e3 * outline.corners.T), facecolor="0.82", edgecolor="0.2", linewidth=0.9)
    _frame(axis, 1e3 * (outline.corners.min(axis=0) + outline.corners.max(axis=0)) / 2.0, 620.0 * outline.extent_m)


def _show_push(axis: Any, plan: ShapePlan, family: str, number: int) -> None:
    """Draw an object before a push (grey) and after it (blue), its feet, its centre of mass and the pusher (orange)."""
    drawn, body, _ = draw_named(plan, family, number)
    pushed = push_named(plan, family, number)
    shown = _telling_push(pushed, drawn.outline)
    pusher, outcome = pushed.pushers[shown], pushed.outcomes[shown]
    before = 1e3 * drawn.outline.corners
    after = 1e3 * _moved(drawn.outline.corners, outcome)
    start = 1e3 * pusher[:2]
    end = start + 1e3 * pusher[3] * np.array([*cos(pusher[2:3]), *sin(pusher[2:3])])
    radius = 1e3 * drawn.pusher_radius_m
    axis.fill(*before.T, facecolor="0.86", edgecolor="0.45", linewidth=0.8)
    axis.scatter(*(1e3 * body.feet_m.T), s=1.0 + 60.0 * body.loads, color="0.45", linewidths=0.0)
    axis.plot(*(1e3 * np.array(drawn.centre_of_mass_m)), "+", color="black", markersize=5.0)
    axis.fill(*after.T, facecolor="none", edgecolor="tab:blue", linewidth=1.1)
    axis.add_patch(Circle(tuple(start), radius, facecolor="none", edgecolor="tab:orange", linewidth=1.0))
    axis.add_patch(Circle(tuple(end), radius, color="tab:orange", linewidth=0.0))
    axis.plot(*np.stack([start, end]).T, color="tab:orange", linewidth=1.0)
    everything = np.concatenate([before, after, [start - radius, start + radius, end - radius, end + radius]])
    low, high = everything.min(axis=0), everything.max(axis=0)
    _frame(axis, (low + high) / 2.0, 0.62 * float((high - low).max()))


def _telling_push(pushed: PushedObject, outline: Outline) -> int:
    """Return the first push, not longer than the object, that moves it visibly, or else the one that moves it most."""
    moved = np.hypot(pushed.outcomes[:, 0], pushed.outcomes[:, 1])
    telling = (moved > LEAST_MOTION * outline.size_m) & (pushed.pushers[:, 3] < outline.extent_m)
    return int(telling.argmax() if telling.any() else moved.argmax())


def _moved(corners: Array, pose: Array) -> Array:
    """Return corners (n, 2) after a motion x_m, y_m, yaw_rad of their frame."""
    (c,), (s,) = cos(pose[2:]), sin(pose[2:])
    return np.asarray(corners @ np.array([[c, s], [-s, c]]) + pose[:2])


def _frame(axis: Any, centre: Array, half: float) -> None:
    """Set the limits of a square cell in mm, and draw a bar of a round length in its lower left corner."""
    x, y = centre
    axis.set_xlim(x - half, x + half)
    axis.set_ylim(y - half, y + half)
    axis.set_aspect("equal")
    bar = max((length for length in _BARS_MM if length < 0.9 * half), default=_BARS_MM[0])
    left, bottom = x - 0.94 * half, y - 0.9 * half
    axis.plot([left, left + bar], [bottom, bottom], color="black", linewidth=1.6, solid_capstyle="butt")
    axis.text(left, bottom + 0.07 * half, f"{bar} mm", fontsize=5.5)
