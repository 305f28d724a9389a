"""Pictures of the examples in the documentation: a photograph of a wrench, and the mask of a mug, at 0.4 mm a pixel.

    python -m benchmarks.example_pictures [--out docs/images]

``view.png`` is a rendered photograph (``benchmarks.photographs``) of a wrench of 180 mm on a wooden table, with a
palette of 48 colours, for fewer bytes. ``mug.png`` is a mask of a mug with its handle, 110 mm across, white on black.
Their outlines are drawn by the families of the trainer. Both are 256 x 192 mm.
"""

import argparse
import math
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt
from PIL import Image

from benchmarks.photographs import photograph_of, rendered_mask
from benchmarks.real_pushes import make_folder
from service.errors import CazslError
from training.shapes.outlines import draw_outline

VIEW_FILE, MUG_FILE = "view.png", "mug.png"
METRES_PER_PIXEL: Final = 0.0004
SIZE: Final = (640, 480)  # pixels
WRENCH_M: Final = 0.180
MUG_M: Final = 0.110
WRENCH_SEED: Final = 3
MUG_SEED: Final = 3
PHOTOGRAPH_SEED: Final = 5
COLOURS: Final = 48


def polygon(
    family: str, extent_m: float, seed: int, turn_rad: float, middle: tuple[float, float]
) -> npt.NDArray[np.float64]:
    """Return the corners of an object, in pixels from the upper left corner of the picture, about a middle.

    Args:
        family: of outlines.
        extent_m: its largest distance between corners.
        seed: of its proportions.
        turn_rad: turn from the orientation that is drawn with the seed.
        middle: of the object, over width and height of the picture.
    """
    outline = draw_outline(family, np.random.default_rng(seed))
    corners = (outline.corners - outline.centroid_m) * (extent_m / outline.extent_m / METRES_PER_PIXEL)
    cos, sin = math.cos(turn_rad), math.sin(turn_rad)
    turned = corners @ np.array([[cos, sin], [-sin, cos]]) * (1.0, -1.0)
    return np.asarray(turned - (turned.min(axis=0) + turned.max(axis=0)) / 2.0 + np.array(SIZE) * middle)


def wrench() -> npt.NDArray[np.float64]:
    """Return the corners of the wrench in ``VIEW_FILE``, in pixels from the upper left corner."""
    return polygon("wrench", WRENCH_M, WRENCH_SEED, 0.0, (0.52, 0.47))


def draw_view(path: Path) -> None:
    """Draw the photograph of a wrench on a wooden table."""
    shown = photograph_of(wrench(), SIZE, "wood", np.random.default_rng(PHOTOGRAPH_SEED))
    few = Image.fromarray(shown.levels).quantize(COLOURS, Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE)
    few.save(path, optimize=True)


def draw_mug(path: Path) -> None:
    """Draw the mask of a mug."""
    coverage = rendered_mask(polygon("mug", MUG_M, MUG_SEED, 0.0, (0.5, 0.5)), SIZE)
    Image.fromarray(np.round(255.0 * coverage).astype(np.uint8)).save(path, optimize=True)


def main(arguments: Sequence[str] | None = None) -> None:
    """Draw both pictures."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.example_pictures",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--out", type=Path, default=Path("docs/images"), help="folder of the pictures (docs/images)")
    folder: Path = parser.parse_args(arguments).out
    try:
        make_folder(folder)
    except CazslError as error:
        sys.exit(f"error: {error}")
    draw_view(folder / VIEW_FILE)
    draw_mug(folder / MUG_FILE)
    print(f"wrote {folder / VIEW_FILE} and {folder / MUG_FILE}; next: python -m benchmarks.any_object")


if __name__ == "__main__":
    main()
