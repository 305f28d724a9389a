"""Gallery of views: some objects as drawn, as a camera sees them, and as a model's visual context."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure

from service.pushing.contexts import VISUAL_SIZE, ObjectContext
from service.pushing.images import FIELD_OF_VIEW_M, GreyImage, visual_context
from training.simulation.drawing import photograph, top_down_view

# Objects with every shape, every weight, none to two weights, and both positions in a triangle.
GALLERY_OBJECTS: Final = (
    "1a2a3a4a", "1a1a1a1a", "2a2a2a2a", "3a3a3a3a", "4a4a4a4a", "1b2a3a4a",
    "1c2a3a4a", "2b2a4a4a", "2B2a4a4a", "2C3a1a4a", "3c4b2a1a", "4a4c1a3b",
)  # fmt: skip
_HALF_MM: Final = 1000.0 * FIELD_OF_VIEW_M / 2.0


def draw_gallery(path: Path, descriptors: Sequence[str] = GALLERY_OBJECTS, seed: int = 0) -> None:
    """Write a PNG with a column per object: clean view, camera view, and the 32 x 32 context of each."""
    rows = ("drawn", "camera", "32 x 32\nof drawn", "32 x 32\nof camera")
    figure = Figure(figsize=(1.4 * len(descriptors), 1.36 * len(rows) + 0.5), dpi=100, layout="constrained")
    axes = figure.subplots(len(rows), len(descriptors), squeeze=False, sharex=True, sharey=True)
    for column, descriptor in enumerate(descriptors):
        drawn, photo = top_down_view(ObjectContext.from_descriptor(descriptor)), photograph(descriptor, seed)
        for row, view in enumerate((drawn, photo, _context_of(drawn), _context_of(photo))):
            _show(axes[row, column], view)
        axes[0, column].set_title(descriptor, family="monospace", fontsize=10)
    for row, name in enumerate(rows):
        axes[row, 0].set_ylabel(name, fontsize=9)
    _show_axes(axes[0, 0])
    figure.supxlabel("mm, in the object frame: side 1 looks right (+x), side 2 up (+y)", fontsize=9)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, metadata={"Software": None})  # without a version, so that equal images are equal files


def _context_of(view: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint8]:
    """Return the visual context of a view, [32, 32]."""
    return np.frombuffer(visual_context(GreyImage(view)).levels, np.uint8).reshape(VISUAL_SIZE, VISUAL_SIZE)


def _show(axis: Any, view: npt.NDArray[np.uint8]) -> None:
    extent = (-_HALF_MM, _HALF_MM, -_HALF_MM, _HALF_MM)
    axis.imshow(view, cmap="gray", vmin=0, vmax=255, extent=extent, interpolation="nearest")
    axis.set_xticks((-50, 0, 50))
    axis.set_yticks((-50, 0, 50))
    axis.tick_params(labelsize=7, length=2)


def _show_axes(axis: Any) -> None:
    """Draw arrows for the object's axes."""
    for x_mm, y_mm, name in ((24, 0, "x"), (0, 24, "y")):
        axis.annotate("", (x_mm, y_mm), (0, 0), arrowprops={"arrowstyle": "->", "color": "tab:red", "lw": 1.2})
        axis.text(x_mm * 1.35, y_mm * 1.35, name, color="tab:red", ha="center", va="center", fontsize=9)
