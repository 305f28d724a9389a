"""Objects whose geometry is known from their context: Omnipush's sides, or the silhouette in a view.

A silhouette is the part of a view that is brighter than the middle between object and background, with linear
interpolation between the cells. Its edge is known within a few millimetres, so a margin is left before a push is said
to miss it. Objects are cached.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Final, Protocol, Self

import numpy as np
import numpy.typing as npt

from service.model.tensors import ContextKind, FloatArray, IndexArray
from service.pushing.contexts import BITS_PER_SIDE, SHAPE_DIGITS, SIDES, VISUAL_SIZE, VisualContext
from service.pushing.first_contact import first_contact
from service.pushing.image_quality import QualityFlag, bright_cells, quality_flags
from service.pushing.images import FIELD_OF_VIEW_M
from service.pushing.outlines import Outline
from service.pushing.poses import DoubleArray
from service.pushing.sides import CORE_HALF_WIDTH_M, SIDE_SHAPES, outline_of_shapes, quarter_turn
from service.turns import pause

Disc = tuple[float, float, float]  # x, y and radius in m
VIEW_MARGIN_M: Final = 0.002
_INFINITE: Final = float("inf")
_CELL_M: Final = FIELD_OF_VIEW_M / VISUAL_SIZE
_CACHED_OBJECTS: Final = 1024  # up to 10 KB each
_PART: Final = 64  # objects between two pauses
_CHUNK_PAIRS: Final = 1 << 18  # of a push and a point of a silhouette: a few MB
# Discs inside each shape of side, which faces +x, and the core's half behind it.
_DISCS: Final[dict[str, tuple[Disc, ...]]] = {
    "1": ((0.022, 0.0, 0.0265), (0.040, 0.017, 0.0115), (0.040, -0.017, 0.0115), (0.048, 0.0215, 0.007)),
    "2": ((0.029, 0.0, 0.023), (0.045, 0.0, 0.014), (0.057, 0.0, 0.0068)),
    "3": ((0.029, 0.0, 0.0288),),
    "4": ((0.034, 0.0, 0.0289), (0.053, 0.019, 0.0098), (0.053, -0.019, 0.0098)),
}
_CORE: Final[Disc] = (0.0, 0.0, CORE_HALF_WIDTH_M)


class Contexts(Protocol):
    """Contexts of some pushes: distinct tensors, and the index of each push's."""

    @property
    def kind(self) -> ContextKind:
        """Return the kind of all of them."""
        ...

    @property
    def tensors(self) -> tuple[FloatArray, ...]:
        """Return the tensors, (g, ...) each, in the order of a model's inputs."""
        ...

    @property
    def index(self) -> IndexArray | None:
        """Return the context of each push, (n,), or None without contexts."""
        ...

    @property
    def flags(self) -> Sequence[Sequence[QualityFlag]]:
        """Return the faults of the picture of each context, or an empty list if none came from a picture."""
        ...


class Form(Protocol):
    """Form of an object: which pushes meet it, in its frame."""

    def misses(self, pushers: DoubleArray, radius_m: float) -> npt.NDArray[np.bool_]:
        """Return (n,) true for pushers (n, 4), x_m, y_m, angle_rad, length_m, that never touch."""
        ...

    def distance_m(self, points: DoubleArray) -> DoubleArray:
        """Return the distance (n,) of points (n, 2) from the edge, negative inside."""
        ...

    def gap_m(self, pusher: DoubleArray) -> float:
        """Return how near the middle of the tip of one push (4,) that misses comes to the edge."""
        ...


@dataclass(frozen=True, eq=False, slots=True)
class KnownObject:
    """Object of known form, with bounds that settle most pushes without it.

    Attributes:
        form: the exact form.
        reach_m: (4,) how far the object reaches along +x, +y, -x and -y.
        half_width_m: no point is further than this from both axes.
        discs: discs that lie inside the object.
        margin_m: error of the form.
        furthest_m: no point is further than this from the origin.
        flags: faults of the picture.
    """

    form: Form
    reach_m: tuple[float, float, float, float]
    half_width_m: float
    discs: tuple[Disc, ...]
    margin_m: float = 0.0
    furthest_m: float = _INFINITE
    flags: tuple[QualityFlag, ...] = ()


@dataclass(frozen=True, slots=True)
class Polygon:
    """Form of a polygon, exact."""

    outline: Outline

    def misses(self, pushers: DoubleArray, radius_m: float) -> npt.NDArray[np.bool_]:
        """See ``Form.misses``."""
        return np.isinf(first_contact(self.outline, pushers, radius_m).travel_m)

    def distance_m(self, points: DoubleArray) -> DoubleArray:
        """See ``Form.distance_m``."""
        return self.outline.distance_m(points)

    def gap_m(self, pusher: DoubleArray) -> float:
        """See ``Form.gap_m``."""
        ends = pusher[:2] + np.array([[0.0], [pusher[3]]]) * (np.cos(pusher[2]), np.sin(pusher[2]))
        corners = _from_segments(pusher[None], self.outline.corners).min()
        return float(min(corners, self.outline.distance_m(ends).min()))


@dataclass(frozen=True, eq=False, slots=True)
class _Silhouette:
    """Form of the bright part of a view."""

    grey: DoubleArray  # (32, 32), row 0 at the top
    level: float
    edge_m: DoubleArray
    """(k, 2) the places between neighbouring cells where the grey passes the level."""

    @classmethod
    def of(cls, grey: npt.NDArray[np.uint8], level: float) -> Self:
        """Create the form of a view."""
        known = grey.astype(np.float64)
        across, down = _crossings(known, level), _crossings(known.T, level)
        places = np.concatenate([across, down[:, ::-1]])  # row, column
        half = (VISUAL_SIZE - 1) / 2.0
        return cls(known, level, np.column_stack([places[:, 1] - half, half - places[:, 0]]) * _CELL_M)

    def misses(self, pushers: DoubleArray, radius_m: float) -> npt.NDArray[np.bool_]:
        """See ``Form.misses``."""
        far = np.ones(len(pushers), dtype=np.bool_)
        step = max(1, _CHUNK_PAIRS // max(1, len(self.edge_m)))
        for begin in range(0, len(pushers), step):
            part = slice(begin, begin + step)
            nearest = _from_segments(pushers[part], self.edge_m).min(axis=1, initial=_INFINITE)
            far[part] = nearest > radius_m + VIEW_MARGIN_M
        return far & ~self._holds(pushers[:, :2])

    def distance_m(self, points: DoubleArray) -> DoubleArray:
        """See ``Form.distance_m``."""
        x, y = points[:, 0, None] - self.edge_m[:, 0], points[:, 1, None] - self.edge_m[:, 1]
        apart = np.hypot(x, y).min(axis=1, initial=_INFINITE)
        return np.asarray(np.where(self._holds(points), -apart, apart))

    def gap_m(self, pusher: DoubleArray) -> float:
        """See ``Form.gap_m``."""
        return float(_from_segments(pusher[None], self.edge_m).min(initial=_INFINITE))

    def _holds(self, points: DoubleArray) -> npt.NDArray[np.bool_]:
        """Return (n,) true for the points (n, 2) inside."""
        half = (VISUAL_SIZE - 1) / 2.0
        column, row = half + points[:, 0] / _CELL_M, half - points[:, 1] / _CELL_M
        within = (np.minimum(row, column) >= -0.5) & (np.maximum(row, column) <= VISUAL_SIZE - 0.5)
        row, column = np.clip(row, 0.0, VISUAL_SIZE - 1.0), np.clip(column, 0.0, VISUAL_SIZE - 1.0)
        top = np.minimum(row.astype(np.int64), VISUAL_SIZE - 2)
        left = np.minimum(column.astype(np.int64), VISUAL_SIZE - 2)
        down, right = row - top, column - left
        upper = (1.0 - right) * self.grey[top, left] + right * self.grey[top, left + 1]
        lower = (1.0 - right) * self.grey[top + 1, left] + right * self.grey[top + 1, left + 1]
        found: npt.NDArray[np.bool_] = within & ((1.0 - down) * upper + down * lower > self.level)
        return found


_NOWHERE: Final = _Silhouette(np.zeros((VISUAL_SIZE, VISUAL_SIZE)), 0.0, np.empty((0, 2)))


def known_object(kind: ContextKind, tensor: bytes) -> KnownObject:
    """Return the object that an indicator or a visual context describes, given by the bytes of its tensor."""
    return viewed_object(tensor) if kind is ContextKind.VISUAL else _described_object(tensor)


def known_objects(contexts: Contexts) -> Iterator[tuple[KnownObject, IndexArray]]:
    """Yield each object whose form is known, with the rows of its pushes in rising order."""
    if contexts.index is None or contexts.kind not in (ContextKind.INDICATOR, ContextKind.VISUAL):
        return
    tensor, keys = contexts.tensors[0], contexts.index
    if contexts.kind is ContextKind.INDICATOR:
        keys = shape_keys(tensor)[keys]
    order = np.argsort(keys, kind="stable")
    different, begins = np.unique(keys[order], return_index=True)
    for number, (key, rows) in enumerate(zip(different.tolist(), np.split(order, begins[1:]), strict=True)):
        if number % _PART == 0:
            pause()
        yield (
            omnipush_object(key) if contexts.kind is ContextKind.INDICATOR else viewed_object(tensor[key].tobytes()),
            rows,
        )


def shape_keys(indicators: FloatArray) -> IndexArray:
    """Return the number (g,) of the shapes of each object's sides: 0 to 255. Weights do not count."""
    shapes = indicators.reshape(-1, SIDES, BITS_PER_SIDE)[:, :, : len(SHAPE_DIGITS)].argmax(axis=2)
    return np.asarray(shapes @ len(SHAPE_DIGITS) ** np.arange(SIDES), dtype=np.int64)


def weight_counts(indicators: FloatArray) -> IndexArray:
    """Return the number (g,) of sides with a weight."""
    without = indicators.reshape(-1, SIDES, BITS_PER_SIDE)[:, :, len(SHAPE_DIGITS)]
    return np.asarray((without == 0.0).sum(axis=1), dtype=np.int64)


@lru_cache(maxsize=len(SHAPE_DIGITS) ** SIDES)
def omnipush_object(key: int) -> KnownObject:
    """Return the object of Omnipush whose sides have the shapes of a key."""
    digits = [SHAPE_DIGITS[key // len(SHAPE_DIGITS) ** side % len(SHAPE_DIGITS)] for side in range(SIDES)]
    discs = [_CORE]
    for side, digit in enumerate(digits):
        (xx, xy), (yx, yy) = quarter_turn(side).tolist()
        discs += [(xx * x + xy * y, yx * x + yy * y, radius) for x, y, radius in _DISCS[digit]]
    first, second, third, fourth = (_reach_m(digit) for digit in digits)
    outline = outline_of_shapes("".join(digits))
    return KnownObject(
        Polygon(outline),
        (first, second, third, fourth),
        CORE_HALF_WIDTH_M,
        tuple(discs),
        furthest_m=float(np.hypot(*outline.corners.T).max()),
    )


@lru_cache(maxsize=_CACHED_OBJECTS)
def _described_object(tensor: bytes) -> KnownObject:
    return omnipush_object(int(shape_keys(np.frombuffer(tensor, dtype=np.float32))[0]))


@lru_cache(maxsize=_CACHED_OBJECTS)
def viewed_object(levels: bytes) -> KnownObject:
    """Return the object in a visual context of 1,024 levels, float32 in [0, 1]."""
    grey = np.rint(np.frombuffer(levels, dtype=np.float32) * 255.0).astype(np.uint8)
    flags = quality_flags(VisualContext(grey.tobytes()))
    if QualityFlag.BLANK in flags:
        return KnownObject(_NOWHERE, (0.0,) * 4, _INFINITE, (), flags=flags)
    square = grey.reshape(VISUAL_SIZE, VISUAL_SIZE)
    bright = bright_cells(square)
    silhouette = _Silhouette.of(square, (square[bright].mean() + square[~bright].mean()) / 2.0)
    places = silhouette.edge_m
    right, top = places.max(axis=0) + VIEW_MARGIN_M
    left, bottom = -places.min(axis=0) + VIEW_MARGIN_M
    centre = places.mean(axis=0, keepdims=True)
    depth = -float(silhouette.distance_m(centre)[0]) - VIEW_MARGIN_M
    discs = ((float(centre[0, 0]), float(centre[0, 1]), depth),) if depth > 0.0 else ()
    reach = (float(right), float(top), float(left), float(bottom))
    return KnownObject(silhouette, reach, _INFINITE, discs, VIEW_MARGIN_M, flags=flags)


@lru_cache(maxsize=len(SHAPE_DIGITS))
def _reach_m(digit: str) -> float:
    return float(max(piece[:, 0].max() for piece in SIDE_SHAPES[digit]()))


def _crossings(grey: DoubleArray, level: float) -> DoubleArray:
    """Return the places (k, 2), row and column, where the grey passes a level between neighbours in a row."""
    bright = grey > level
    rows, columns = np.nonzero(bright[:, :-1] != bright[:, 1:])
    before, after = grey[rows, columns], grey[rows, columns + 1]
    return np.column_stack([rows, columns + (level - before) / (after - before)])


def _from_segments(pushers: DoubleArray, points: DoubleArray) -> DoubleArray:
    """Return the distances (n, k) of points (k, 2) from the ways of the tips of pushers (n, 4)."""
    cos, sin = np.cos(pushers[:, 2, None]), np.sin(pushers[:, 2, None])
    x, y = points[:, 0] - pushers[:, 0, None], points[:, 1] - pushers[:, 1, None]
    along = np.clip(x * cos + y * sin, 0.0, pushers[:, 3, None])
    return np.hypot(x - along * cos, y - along * sin)
