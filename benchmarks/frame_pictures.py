"""Pictures of the frames: an Omnipush object with its sides in millimetres, and the frame of an image.

    python -m benchmarks.frame_pictures [--out docs/images]

``object-frame.png`` shows origin and axes of the object frame, a push, the four shapes of sides with their dimensions,
and ``4a4a4a4a``, which is a cross of 126 mm and no box. ``picture-frame.png`` shows the two conventions of an image:
a picture with its scale, for models of any shape, and a view with Omnipush's width and grey levels. Lengths and levels
are those of the code that draws and reads: ``service/pushing/sides.py`` and ``service/pushing/images.py``.
"""

import argparse
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle

from service.pushing import sides
from service.pushing.contexts import ObjectContext
from service.pushing.images import BACKGROUND_LEVEL, BODY_LEVEL, FIELD_OF_VIEW_M
from service.pushing.outlines import Outline
from service.pushing.poses import PUSH_LENGTH_M, DoubleArray
from training.simulation import solids
from training.simulation.drawing import top_down_view, weight_level
from training.simulation.scene import PUSHER_RADIUS_M

OBJECT_FILE: Final = "object-frame.png"
PICTURE_FILE: Final = "picture-frame.png"
SHOWN: Final = ObjectContext.from_descriptor("1a2b3c4a")
CROSS: Final = ObjectContext.from_descriptor("4a4a4a4a")
START_M: Final = (-0.075, 0.0)
PICTURE_PIXELS: Final = (320, 240)
METRES_PER_PIXEL: Final = 0.0004
BOX_MM: Final = (62.0, 38.0)  # of the object in the example of a picture
_GREY, _BLUE, _ORANGE, _GREEN = "0.86", "tab:blue", "tab:orange", "tab:green"


def draw_object_frame(path: Path) -> None:
    """Draw the frame of an object, the dimensions of its sides, and the object that is no box."""
    figure = Figure(figsize=(13.5, 6.6), dpi=80, layout="constrained")
    left, right = figure.subplots(1, 2)
    _draw_sides(left)
    _draw_cross(right)
    figure.savefig(path, metadata={"Software": None})


def draw_picture_frame(path: Path) -> None:
    """Draw the frame of a picture with a scale, and of a view of an Omnipush object."""
    figure = Figure(figsize=(13.5, 5.4), dpi=80, layout="constrained")
    left, right = figure.subplots(1, 2)
    _draw_picture(left)
    _draw_view(right)
    figure.savefig(path, metadata={"Software": None})


def _draw_sides(axes: Any) -> None:
    """Draw the object 1a2b3c4a with its axes, weights, dimensions, and a push."""
    half = _mm(sides.CORE_HALF_WIDTH_M)
    _fill(axes, sides.outline(SHOWN))
    axes.plot(*_square(half).T, color="0.6", linewidth=0.8, linestyle="--")
    _draw_axes(axes, 88.0)
    for weight in solids.solid(SHOWN).weights:
        place = (_mm(weight.x_m), _mm(weight.y_m))
        axes.add_patch(Circle(place, _mm(solids.WEIGHT_RADIUS_M), facecolor="0.65", edgecolor="0.3"))
        _label(axes, (place[0] - 12.0, place[1] + 14.0), f"{1e3 * weight.mass_kg:.0f} g", "0.3")
    for x, y, name in (
        (78, 35, "1 concave"),
        (-30, 70, "2 triangular"),
        (-82, 31, "3 circular"),
        (0, -70, "4 rectangular"),
    ):
        axes.text(x, y, f"side {name}", ha="center", va="center", fontsize=9, fontweight="bold")
    concave, bite = _mm(sides.CONCAVE_DEPTH_M), _mm(sides.CONCAVE_BITE_DEPTH_M)
    _dimension(axes, (half, -34), (half + concave, -34), f"{concave:.0f}", (0.0, -5.0))
    _dimension(axes, (half + concave - bite, 14), (half + concave, 14), f"{bite:.0f}", (3.0, 4.0))
    mouth = _mm(sides.CONCAVE_BITE_HALF_WIDTH_M)
    _dimension(axes, (half + concave + 6, -mouth), (half + concave + 6, mouth), f"{2 * mouth:.0f}", (5.0, 8.0))
    _dimension(axes, (34, half), (34, half + _mm(sides.TRIANGLE_DEPTH_M)), f"{_mm(sides.TRIANGLE_DEPTH_M):.0f}")
    radius = _mm(sides.CIRCLE_RADIUS_M)
    _dimension(axes, (-half - radius, -34), (-half, -34), f"{radius:.0f}", (0.0, -5.0))
    rectangle = _mm(sides.RECTANGLE_DEPTH_M)
    _dimension(axes, (34, -half - rectangle), (34, -half), f"{rectangle:.0f}")
    _dimension(axes, (-half, -18), (half, -18), f"core {2 * half:.0f} x {2 * half:.0f}", (0.0, -5.0))
    start = np.array(START_M) * 1e3
    end = np.array([start[0] + _mm(PUSH_LENGTH_M), start[1]])
    axes.add_patch(Circle(tuple(start), _mm(PUSHER_RADIUS_M), facecolor="none", edgecolor=_ORANGE, linewidth=1.4))
    axes.add_patch(Circle(tuple(end), _mm(PUSHER_RADIUS_M), facecolor="none", edgecolor=_ORANGE, linestyle="--"))
    axes.annotate("", end, start, arrowprops={"arrowstyle": "->", "color": _ORANGE, "linewidth": 1.8})
    axes.text(
        -106,
        -66,
        f"pusher x = {START_M[0]:g}, y = 0, angle = 0:\nthe tip ({_mm(PUSHER_RADIUS_M):.2f} mm radius)\nstarts "
        f"{-start[0]:.0f} mm from the origin\nand moves {_mm(PUSH_LENGTH_M):.0f} mm along x",
        color=_ORANGE,
        fontsize=8.5,
        va="center",
    )
    _frame(axes, "Frame of 1a2b3c4a, lengths in mm: x through side 1, y through side 2")


def _draw_cross(axes: Any) -> None:
    """Draw the object 4a4a4a4a beside the box that it is not."""
    found = sides.outline(CROSS)
    low, high = _mm(found.corners.min()), _mm(found.corners.max())
    half, depth = _mm(sides.CORE_HALF_WIDTH_M), _mm(sides.RECTANGLE_DEPTH_M)
    axes.plot(*_square(high).T, color="tab:red", linewidth=1.2, linestyle="--")
    _fill(axes, found)
    axes.plot(*_square(half).T, color="0.6", linewidth=0.8, linestyle="--")
    _draw_axes(axes, 80.0)
    _dimension(axes, (low, -74), (high, -74), f"{high - low:.0f}", (0.0, -5.0))
    _dimension(axes, (-half, -18), (half, -18), f"{2 * half:.0f}", (0.0, -5.0))
    _dimension(axes, (34, half), (34, half + depth), f"{depth:.0f}")
    axes.text(-46, 54, "not this", color="tab:red", ha="center", fontsize=9)
    _frame(axes, f"4a4a4a4a is a cross of {high - low:.0f} mm, not a box. A box is an outline")


def _draw_picture(axes: Any) -> None:
    """Draw a picture with its frame and scale, an object in it, and its outline in that frame."""
    width, height = (1e3 * METRES_PER_PIXEL * pixels for pixels in PICTURE_PIXELS)
    axes.add_patch(Rectangle((-width / 2, -height / 2), width, height, facecolor="#c9a66b", edgecolor="0.2"))
    turn = math.radians(20.0)
    corners = np.array([(1, 1), (-1, 1), (-1, -1), (1, -1)]) * np.array(BOX_MM) / 2.0
    corners = corners @ np.array([[math.cos(turn), math.sin(turn)], [-math.sin(turn), math.cos(turn)]]) + (10.0, -4.0)
    axes.fill(*corners.T, facecolor="#4a5560", edgecolor=_BLUE, linewidth=2.0)
    _draw_axes(axes, 38.0, "white")
    axes.text(0, height / 2 + 3, f"{PICTURE_PIXELS[0]} pixels x {METRES_PER_PIXEL} m = {width:.0f} mm", ha="center")
    tall = f"{PICTURE_PIXELS[1]} pixels = {height:.0f} mm"
    axes.text(-width / 2 - 3, 0, tall, ha="center", va="center", rotation=90)
    note = (
        "Pushes, outline and answer are in the frame of the picture: origin in its middle,\n"
        "x right, y up. The object stands out from the table, and lies whole in the picture."
    )
    axes.text(-width / 2, -height / 2 - 5, note, va="top", fontsize=9.5)
    axes.text(0, 62, "image with metres_per_pixel: any object", ha="center", fontsize=12)
    axes.set(xlim=(-80, 80), ylim=(-68, 70), aspect="equal")
    axes.axis("off")


def _draw_view(axes: Any) -> None:
    """Draw the view of an Omnipush object as a visual model was trained on, with its grey levels."""
    half = _mm(FIELD_OF_VIEW_M) / 2.0
    axes.imshow(top_down_view(SHOWN), cmap="gray", vmin=0, vmax=255, extent=(-half, half, -half, half))
    _draw_axes(axes, 70.0, "tab:cyan")
    axes.text(0, half + 3, f"{2 * half:.0f} mm, whatever the pixels", ha="center")
    levels = [weight_level(solids.WEIGHT_MASS_KG[letter]) for letter in "bc"]
    note = (
        f"background {BACKGROUND_LEVEL:g} (black)\nobject {BODY_LEVEL:g}\nweight of 60 g {levels[0]:g}\n"
        f"of 150 g {levels[1]:g} (white)\n\norigin: the middle,\nwhich is the centre\nof the core; x right\n"
        "through side 1, y up"
    )
    axes.text(half + 5, 0, note, va="center", fontsize=9.5)
    axes.text(0, half + 16, "image without a scale: Omnipush's objects", ha="center", fontsize=12)
    axes.set(xlim=(-half - 2, half + 75), ylim=(-half - 5, half + 26))
    axes.axis("off")


def _fill(axes: Any, outline: Outline) -> None:
    axes.fill(*(1e3 * outline.corners.T), facecolor=_GREY, edgecolor="0.3", linewidth=1.2)


def _draw_axes(axes: Any, length: float, colour: str = "black") -> None:
    """Draw the origin and both axes of a frame, in mm."""
    for name, tip in (("x", (length, 0.0)), ("y", (0.0, length))):
        axes.annotate("", tip, (0.0, 0.0), arrowprops={"arrowstyle": "->", "color": colour, "linewidth": 1.4})
        axes.text(tip[0] + 3.0, tip[1] + 1.0, name, color=colour, fontsize=12, fontstyle="italic")
    axes.plot(0.0, 0.0, "o", color=colour, markersize=5.0)


def _dimension(
    axes: Any,
    start: tuple[float, float],
    end: tuple[float, float],
    text: str,
    beside: tuple[float, float] = (5.0, 0.0),
) -> None:
    """Draw the distance of two points, as in a technical drawing, with a text beside its middle."""
    axes.annotate("", end, start, arrowprops={"arrowstyle": "<->", "color": _GREEN, "shrinkA": 0, "shrinkB": 0})
    x, y = (start[0] + end[0]) / 2.0 + beside[0], (start[1] + end[1]) / 2.0 + beside[1]
    _label(axes, (x, y), text, _GREEN)


def _label(axes: Any, place: tuple[float, float], text: str, colour: str) -> None:
    """Draw a text on a light ground, so that lines behind it do not hide it."""
    ground = {"facecolor": "white", "edgecolor": "none", "alpha": 0.75, "pad": 0.8}
    axes.text(*place, text, color=colour, ha="center", va="center", fontsize=9, bbox=ground)


def _frame(axes: Any, title: str) -> None:
    axes.set(xlim=(-108, 108), ylim=(-86, 96), aspect="equal", title=title)
    axes.axis("off")


def _square(half: float) -> DoubleArray:
    return half * np.array([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0)])


def _mm(length: float) -> float:
    return 1e3 * length


def main(arguments: Sequence[str] | None = None) -> None:
    """Draw both pictures."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.frame_pictures",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--out", type=Path, default=Path("docs/images"), help="folder of the pictures (docs/images)")
    folder = parser.parse_args(arguments).out
    folder.mkdir(parents=True, exist_ok=True)
    draw_object_frame(folder / OBJECT_FILE)
    draw_picture_frame(folder / PICTURE_FILE)
    print(f"wrote {folder / OBJECT_FILE} and {folder / PICTURE_FILE}; next: look at them")


if __name__ == "__main__":
    main()
