"""Comparison of visual contexts with the drawn views of Omnipush's objects.

A view is linear in the sides that it shows, so that of any object is the view of four plain blocks, plus a part for
each side. The parts are kept in ``omnipush_views.npy``: the views of the 14 kinds of side, uint8 (14, 32, 32), each
beside three plain blocks, as ``python -m benchmarks.omnipush_views`` draws them. The kind of each side is the one whose
part fits its quarter of the view best. The difference is the root mean square of the remainder, in [0, 1].

Drawings of the 250 objects differ by less than 0.001, one that is misplaced by 2 mm by 0.034, one that is turned by 2
degrees by 0.027, camera views by 0.04 and more, boxes and other shapes by 0.13 and more.
"""

from functools import lru_cache
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from service.model.tensors import FloatArray
from service.pushing.contexts import (
    SECOND_POSITION_LETTERS,
    SHAPE_DIGITS,
    SIDES,
    TRIANGULAR,
    VISUAL_SIZE,
    WEIGHT_LETTERS,
)

LARGEST_DIFFERENCE: Final = 0.04
SIDE_KINDS: Final = tuple(
    digit + letter
    for digit in SHAPE_DIGITS
    for letter in WEIGHT_LETTERS
    if digit == TRIANGULAR or letter not in SECOND_POSITION_LETTERS
)
PLAIN: Final = "4a"
_FILE: Final = Path(__file__).with_name("omnipush_views.npy")
_AT_ONCE: Final = 512  # views: 2 MB


class Likeness(NamedTuple):
    """Likeness of a view: the nearest object of Omnipush, and the difference from its drawing."""

    descriptor: str
    difference: float


class _Parts(NamedTuple):
    plain: FloatArray  # (1024,) the view of four plain blocks
    parts: FloatArray  # (4, 14, 1024) what each kind adds on each side
    quarters: FloatArray  # (4, 14, 1024) the same, in the side's quarter of the view only


def likenesses(views: FloatArray) -> list[Likeness]:
    """Return the likeness of each view (g, 1, 32, 32) in [0, 1]."""
    known, found = _parts(), []
    for begin in range(0, len(views), _AT_ONCE):
        rest = views[begin : begin + _AT_ONCE].reshape(-1, VISUAL_SIZE**2) - known.plain
        squares = np.einsum("skp,skp->sk", known.quarters, known.quarters)
        kinds = (squares - 2.0 * np.einsum("gp,skp->gsk", rest, known.quarters)).argmin(axis=2)  # (g, 4)
        for side in range(SIDES):
            rest -= known.parts[side, kinds[:, side]]
        differences = np.sqrt(np.einsum("gp,gp->g", rest, rest) / VISUAL_SIZE**2)
        found += [
            Likeness("".join(SIDE_KINDS[kind] for kind in row), difference)
            for row, difference in zip(kinds.tolist(), differences.tolist(), strict=True)
        ]
    return found


@lru_cache(maxsize=1)
def _parts() -> _Parts:
    views = np.load(_FILE, allow_pickle=False).astype(np.float32) / np.float32(255.0)
    plain = views[SIDE_KINDS.index(PLAIN)]
    middle = (VISUAL_SIZE - 1) / 2.0
    x, y = np.arange(VISUAL_SIZE) - middle, middle - np.arange(VISUAL_SIZE)
    quarter = x[None, :] > np.abs(y[:, None])  # of side 1
    parts, quarters = (_on_all_sides(added) for added in (views - plain, (views - plain) * quarter))
    return _Parts(plain.ravel(), parts, quarters)


def _on_all_sides(added: npt.NDArray[np.float32]) -> FloatArray:
    """Return parts of side 1 (14, 32, 32) on each of the four sides, (4, 14, 1024)."""
    turned = np.stack([np.rot90(added, side, axes=(1, 2)) for side in range(SIDES)])
    return np.ascontiguousarray(turned.reshape(SIDES, len(added), -1))
