"""Omnipush's objects: which contexts describe one of them. They have at most two weights."""

from collections.abc import Callable
from functools import lru_cache
from typing import Final

import numpy as np
import numpy.typing as npt

from service.model.tensors import ContextKind, FloatArray
from service.pushing.contexts import INDICATOR_LENGTH, VISUAL_SIZE
from service.validity.known_objects import weight_counts
from service.validity.views import LARGEST_DIFFERENCE, likenesses

MOST_WEIGHTS: Final = 2
_CACHED: Final = 1024
_WEIGHTLESS: Final = "a"
_SHAPES: Final = {
    ContextKind.INDICATOR: (1, INDICATOR_LENGTH),
    ContextKind.VISUAL: (1, 1, VISUAL_SIZE, VISUAL_SIZE),
}


def unlike_omnipush(kind: ContextKind, tensor: FloatArray) -> tuple[npt.NDArray[np.bool_], Callable[[int], str]]:
    """Return (g,) true for the contexts that are no object of Omnipush, and a function of their number: the reason."""
    if kind is ContextKind.INDICATOR:
        counts = weight_counts(tensor)
        return counts > MOST_WEIGHTS, lambda number: _too_heavy(int(counts[number]))
    found = likenesses(tensor)
    differ = np.array([one.difference > LARGEST_DIFFERENCE for one in found])
    weights = np.array([len(one.descriptor[1::2].replace(_WEIGHTLESS, "")) for one in found])

    def reason(number: int) -> str:
        """Say how the view differs."""
        if not differ[number]:
            return _too_heavy(int(weights[number]))
        nearest, difference = found[number]
        away = f"by {difference:.2f} rms (known: up to {LARGEST_DIFFERENCE:g})"
        return f"the view differs from the drawing of the nearest object, {nearest}, {away}"

    return differ | (weights > MOST_WEIGHTS), reason


def is_omnipush(kind: ContextKind, tensor: bytes) -> bool:
    """Return True if a context, given by the bytes of its tensor, is no object at all or one of Omnipush."""
    return kind not in _SHAPES or _is_omnipush(kind, tensor)


@lru_cache(maxsize=_CACHED)
def _is_omnipush(kind: ContextKind, tensor: bytes) -> bool:
    unlike, _ = unlike_omnipush(kind, np.frombuffer(tensor, dtype=np.float32).reshape(_SHAPES[kind]))
    return not unlike[0]


def _too_heavy(count: int) -> str:
    return f"{count} sides have a weight, and Omnipush's objects have at most {MOST_WEIGHTS}"
