"""Picture of a push map in the documentation: a wrench in a photograph, and what a push at each place would do.

    python -m benchmarks.push_map_picture [--registry models] [--picture docs/images/view.png] [--out docs/images]

The outline is found in the photograph. Each arrow is a push along the normal, at the place where it starts. Its colour
is how far the object's points move over the length of the push, on the left, and how far apart they may end, on the
right. The file is ``push-map.png``.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib.figure import Figure

from benchmarks.any_object_pictures import Backdrop
from benchmarks.example_pictures import METRES_PER_PIXEL
from benchmarks.real_pushes import make_folder
from service.client import Client, ClientError, PushMap
from service.errors import CazslError
from service.pushing.images import decode_colour

FILE: Final = "push-map.png"
LENGTH_M: Final = 0.03
SPACING_M: Final = 0.008
_ARROW_MM: Final = 16.0
_STEP_MM: Final = 4.0  # from the outline to the head of an arrow


def ask(registry: Path, picture: Path) -> PushMap:
    """Return the push map of the object in a photograph, by the models of a registry."""
    with Client.local(str(registry)) as client:
        found = client.find_outline(picture, metres_per_pixel=METRES_PER_PIXEL)
        return client.push_map(found, spacing=SPACING_M, angles=[0.0], length=LENGTH_M)


def draw(found: PushMap, picture: Path, path: Path) -> None:
    """Draw the map over the photograph, twice: coloured by its effectiveness and by its uncertainty."""
    backdrop = Backdrop(decode_colour(picture.read_bytes()).levels, METRES_PER_PIXEL)
    figure = Figure(figsize=(11.0, 3.9), dpi=90, layout="constrained")
    left, right = figure.subplots(1, 2)
    share, apart = 100.0 * found.effectiveness, 1e3 * found.uncertainty
    title = f"a push of {1e3 * LENGTH_M:.0f} mm at each place"
    _draw_arrows(figure, left, found, share, "viridis", f"{title} moves the object by", "% of the push")
    _draw_arrows(figure, right, found, apart, "plasma_r", "and leaves its points uncertain by", "mm (one std)")
    for axes in (left, right):
        axes.imshow(backdrop.levels, extent=backdrop.extent_mm, alpha=0.55)
        axes.set(xlabel="x (mm)", ylabel="y (mm)", aspect="equal")
        axes.tick_params(labelsize=7)
    figure.savefig(path, metadata={"Software": None})


def _draw_arrows(figure: Figure, axes: Any, found: PushMap, colour: Any, colours: str, title: str, unit: str) -> None:
    """Draw an arrow for each push, whose head is near the outline."""
    heading = np.stack([np.cos(found.pushers[:, 2]), np.sin(found.pushers[:, 2])], axis=1)
    tail = 1e3 * found.points - (_ARROW_MM + _STEP_MM) * heading
    arrows = axes.quiver(
        *tail.T, *(_ARROW_MM * heading.T), colour, cmap=colours, angles="xy", scale_units="xy", scale=1.0, width=0.006
    )
    axes.set_title(title, fontsize=10)
    figure.colorbar(arrows, ax=axes, shrink=0.8).set_label(unit, fontsize=9)


def main(arguments: Sequence[str] | None = None) -> None:
    """Draw the picture."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.push_map_picture",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--registry", type=Path, default=Path("models"), help="folder of models (models)")
    parser.add_argument("--picture", type=Path, default=Path("docs/images/view.png"), help="photograph, 0.4 mm a pixel")
    parser.add_argument("--out", type=Path, default=Path("docs/images"), help="folder of the picture (docs/images)")
    given = parser.parse_args(arguments)
    try:
        make_folder(given.out)
        found = ask(given.registry, given.picture)
    except (CazslError, ClientError, OSError) as error:
        sys.exit(f"error: {error}")
    draw(found, given.picture, given.out / FILE)
    best = int(found.effectiveness.argmax())
    x, y = 1e3 * found.points[best]
    print(f"{len(found.pushers)} pushes; the most effective starts at x {x:.0f} mm, y {y:.0f} mm", end=" ")
    print(f"and moves the object by {found.effectiveness[best]:.0%} of the push; wrote {given.out / FILE}")


if __name__ == "__main__":
    main()
