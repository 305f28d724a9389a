"""Views of Omnipush's sides, which the service compares visual contexts with: draw them, and measure the comparison.

    python -m benchmarks.omnipush_views [--write]

Draws each kind of side beside three plain blocks, by the published image convention, and compares the result with the
file in the service, or writes it. Then the difference from the nearest object is printed for drawings of all 250
objects, camera views of them, and drawings of other outlines.
"""

import argparse
from pathlib import Path

import numpy as np
import numpy.typing as npt

from benchmarks.push_predictions import view
from service.pushing.contexts import VISUAL_SIZE, ObjectContext
from service.pushing.images import GreyImage, visual_context
from service.pushing.outlines import Outline
from service.validity import views
from service.validity.views import PLAIN, SIDE_KINDS, likenesses
from training.omnipush.published import omnipush_descriptors
from training.simulation.drawing import photograph, top_down_view

FILE = Path(views.__file__).with_name("omnipush_views.npy")
OTHERS = {
    "box of 120 x 80 mm": [[0.06, 0.04], [-0.06, 0.04], [-0.06, -0.04], [0.06, -0.04]],
    "box of 58 mm": [[0.029, 0.029], [-0.029, 0.029], [-0.029, -0.029], [0.029, -0.029]],
    "L": [[-0.04, -0.04], [0.06, -0.04], [0.06, 0.0], [0.0, 0.0], [0.0, 0.06], [-0.04, 0.06]],
}


def levels(picture: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint8]:
    """Return the visual context (1, 32, 32) of a picture."""
    context = visual_context(GreyImage(picture))
    return np.frombuffer(context.levels, dtype=np.uint8).reshape(1, VISUAL_SIZE, VISUAL_SIZE)


def drawn(descriptor: str) -> npt.NDArray[np.uint8]:
    """Return the view of an object (1, 32, 32)."""
    return levels(top_down_view(ObjectContext.from_descriptor(descriptor)))


def side_views() -> npt.NDArray[np.uint8]:
    """Draw every kind of side beside three plain blocks, (14, 32, 32)."""
    return np.concatenate([drawn(kind + 3 * PLAIN) for kind in SIDE_KINDS])


def main() -> None:
    """Draw the views, compare or write them, and print differences."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--write", action="store_true", help="write the file in the service")
    if parser.parse_args().write:
        np.save(FILE, side_views())
    elif not np.array_equal(np.load(FILE, allow_pickle=False), side_views()):
        raise SystemExit(f"{FILE.name} is not what is drawn: run this command with --write")
    names = omnipush_descriptors()
    pictures = {
        "drawings of the 250 objects": [drawn(name) for name in names],
        "camera views of them": [levels(photograph(name, 0)) for name in names],
        **{name: [levels(view(Outline.of(corners)))] for name, corners in OTHERS.items()},
    }
    print("| views | difference, least | median | largest |\n|---|---|---|---|")
    for name, given in pictures.items():
        found = [one.difference for one in likenesses(np.stack(given).astype(np.float32) / np.float32(255.0))]
        print(f"| {name} | {min(found):.4f} | {np.median(found):.4f} | {max(found):.4f} |")


if __name__ == "__main__":
    main()
