"""Pictures with known warnings: views and photographs as a model knows them, and faulty ones that a user may send.

Views are of the published convention, 160 mm wide, for models of Omnipush's objects. Photographs come with their scale,
for models of any shape. Each picture has one push.
"""

import io
from collections.abc import Callable
from typing import Final

import numpy as np
import numpy.typing as npt
from PIL import Image

from benchmarks.photographs import Photograph, clipped, empty_table, photograph, two_objects
from benchmarks.push_predictions import view
from benchmarks.warning_queries import Queries
from service.pushing.contexts import ObjectContext
from service.pushing.images import BODY_LEVEL, FIELD_OF_VIEW_M
from service.pushing.outlines import Outline
from service.validity.codes import WarningCode
from training.omnipush.published import different_objects
from training.omnipush.views import VIEW_PIXELS
from training.shapes.families import FAMILIES
from training.shapes.outlines import draw_outline
from training.simulation.camera import camera_view
from training.simulation.drawing import top_down_view

View = npt.NDArray[np.uint8]
Draw = Callable[[np.random.Generator], View]
PIXEL_M: Final = FIELD_OF_VIEW_M / VIEW_PIXELS
BLANK: Final = (WarningCode.IMAGE_BLANK, WarningCode.UNFAMILIAR_OBJECT)
CLIPPED: Final = (WarningCode.IMAGE_CLIPPED,)
OFF_CENTRE: Final = (WarningCode.IMAGE_OFF_CENTRE,)
SEVERAL: Final = (WarningCode.IMAGE_SEVERAL_OBJECTS,)
STRANGE: Final = (
    WarningCode.UNFAMILIAR_OBJECT,
    WarningCode.IMAGE_BLANK,
    WarningCode.IMAGE_CLIPPED,
    WarningCode.IMAGE_OFF_CENTRE,
    WarningCode.IMAGE_SEVERAL_OBJECTS,
)
PUSH_OF_A_VIEW: Final = (-0.08, 0.0, 0.0, 0.05)
SIZES_M: Final = (0.03, 0.11)  # of the objects in photographs


def view_queries(count: int, rng: np.random.Generator) -> list[Queries]:
    """Return views for a model of Omnipush's objects: camera views of held-out ones, and others."""
    kinds: dict[str, tuple[tuple[WarningCode, ...], Draw]] = {
        "camera views of held-out objects": ((), _seen),
        "views of other objects: boxes, letters, tools, blobs": (STRANGE[:1], _other),
        "... as a camera sees them": (STRANGE[:1], lambda rng: camera_view(_other(rng), rng)),
        "photographs of any object on any table": (STRANGE, lambda rng: _square(photograph(rng))),
        "photographs of empty tables": (BLANK, lambda rng: _square(empty_table(rng))),
        "one grey level": (BLANK, lambda rng: np.full((VIEW_PIXELS, VIEW_PIXELS), rng.integers(256), dtype=np.uint8)),
        "noise": (STRANGE, lambda rng: rng.integers(0, 256, (VIEW_PIXELS, VIEW_PIXELS), dtype=np.uint8)),
        "dark objects on a bright table": (STRANGE, lambda rng: 255 - _seen(rng)),
        "a camera at 0.5 to 0.75 of its height": (
            STRANGE,
            lambda rng: _seen(rng, lambda one: _scaled(one, rng.uniform(1.33, 2.0))),
        ),
        "a camera at 1.5 to 2.5 times its height": (
            STRANGE,
            lambda rng: _seen(rng, lambda one: _scaled(one, rng.uniform(0.4, 0.67))),
        ),
        "objects that are turned by 15 to 30 degrees": (
            STRANGE[:1],
            lambda rng: _seen(rng, lambda one: _turned(one, rng)),
        ),
        "objects that lie beyond the border by 28 to 63 mm": (
            CLIPPED,
            lambda rng: _seen(rng, lambda one: _moved(one, 0.045, 0.08, rng)),
        ),
        "objects 20 to 40 mm off the centre": (
            OFF_CENTRE,
            lambda rng: _seen(rng, lambda one: _moved(one, 0.02, 0.04, rng)),
        ),
        "a second object in a corner": (SEVERAL, lambda rng: _seen(rng, lambda one: _with_another(one, rng))),
    }
    found = []
    for name, (due, draw) in kinds.items():
        pictures = [_png(draw(rng)) for _ in range(count)]
        pushers = np.tile(PUSH_OF_A_VIEW, (count, 1))
        found.append(Queries(name, due, not due, pushers, (), np.arange(count), pictures))
    return found


def photograph_queries(count: int, rng: np.random.Generator) -> list[Queries]:
    """Return photographs with their scale for a model of any shape: of one object, and faulty ones."""
    kinds: dict[str, tuple[tuple[WarningCode, ...], Callable[[np.random.Generator], Photograph]]] = {
        "photographs of one object": ((), photograph),
        "photographs of two objects": (SEVERAL, two_objects),
        "photographs of a clipped object": (CLIPPED, clipped),
        "photographs of empty tables": (BLANK, empty_table),
    }
    found = []
    for name, (due, draw) in kinds.items():
        shown = [draw(rng) for _ in range(count)]
        placed = [_placed(one, rng) for one in shown]
        pushers, scales_m = np.array([push for push, _ in placed]), [scale_m for _, scale_m in placed]
        found.append(
            Queries(name, due, not due, pushers, (), np.arange(count), [one.jpeg() for one in shown], scales_m)
        )
    return found


def _placed(shown: Photograph, rng: np.random.Generator) -> tuple[tuple[float, ...], float]:
    """Return a push towards the object in a photograph, and the scale."""
    height, width = shown.mask.shape
    rows, columns = np.nonzero(shown.mask) if shown.mask.any() else np.array([[0, height], [0, width]])
    extent = max(np.ptp(rows), np.ptp(columns), 1)
    size_m = float(rng.uniform(*SIZES_M))
    scale_m = size_m / float(extent)
    x, y = (columns.mean() - width / 2.0) * scale_m, (height / 2.0 - rows.mean()) * scale_m
    return (float(x) - 0.8 * size_m, float(y), 0.0, size_m), scale_m  # past the middle, so that it touches


def _other(rng: np.random.Generator) -> View:
    """Draw an object of another shape, 60 to 140 mm wide, by the convention of the views."""
    while True:
        one = draw_outline(str(rng.choice(list(FAMILIES))), rng)
        corners = (one.corners - one.centroid_m) * (rng.uniform(0.06, 0.14) / one.extent_m)
        if np.abs(corners).max() < FIELD_OF_VIEW_M / 2.0:
            return view(Outline.of(corners))


def _square(shown: Photograph) -> View:
    """Return the middle of a photograph in grey, as high as wide."""
    image = Image.fromarray(shown.levels).convert("L")
    side = min(image.size)
    left, top = (image.width - side) // 2, (image.height - side) // 2
    return np.asarray(image.crop((left, top, left + side, top + side)).resize((VIEW_PIXELS, VIEW_PIXELS)))


def _seen(rng: np.random.Generator, change: Callable[[View], View] = lambda shown: shown) -> View:
    """Draw a held-out object of Omnipush, changed, as a camera sees it."""
    names = different_objects().test
    shown = top_down_view(ObjectContext.from_descriptor(names[int(rng.integers(len(names)))]))
    return camera_view(change(shown), rng)


def _scaled(shown: View, scale: float) -> View:
    """Return a view scaled about its middle."""
    offset = VIEW_PIXELS / 2.0 * (1.0 - 1.0 / scale)
    return _transformed(shown, (1.0 / scale, 0.0, offset, 0.0, 1.0 / scale, offset))


def _moved(shown: View, low_m: float, high_m: float, rng: np.random.Generator) -> View:
    """Return a view moved towards one side."""
    away = float(rng.uniform(low_m, high_m)) * float(rng.choice([-1.0, 1.0])) / PIXEL_M
    x, y = (away, 0.0) if rng.random() < 0.5 else (0.0, away)
    return _transformed(shown, (1.0, 0.0, -x, 0.0, 1.0, -y))


def _transformed(shown: View, matrix: tuple[float, ...]) -> View:
    image = Image.fromarray(shown)
    return np.asarray(image.transform(image.size, Image.Transform.AFFINE, matrix, Image.Resampling.BILINEAR))


def _turned(shown: View, rng: np.random.Generator) -> View:
    """Return a view turned by 15 to 30 degrees."""
    degrees = float(rng.uniform(15.0, 30.0)) * float(rng.choice([-1.0, 1.0]))
    return np.asarray(Image.fromarray(shown).rotate(degrees, Image.Resampling.BILINEAR))


def _with_another(shown: View, rng: np.random.Generator) -> View:
    """Return a view with a box of 22 to 32 mm in a corner."""
    side, away = round(float(rng.uniform(0.022, 0.032)) / PIXEL_M), round(0.004 / PIXEL_M)
    row, column = (int(rng.choice([away, VIEW_PIXELS - side - away])) for _ in range(2))
    changed = shown.copy()
    changed[row : row + side, column : column + side] = round(255 * BODY_LEVEL)
    return changed


def _png(shown: View) -> bytes:
    buffer = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(shown)).save(buffer, "PNG", compress_level=1)
    return buffer.getvalue()
