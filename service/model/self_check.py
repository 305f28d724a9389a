"""Self-check of a version: a stored input, and the stored output that the predictor must give for it.

The check is also the measurement of the version's cost.
"""

import math
import time
from typing import Final

import numpy as np

from service.errors import BrokenModelError, CazslError
from service.model.manifest import Manifest
from service.model.predictor import ROWS_AT_ONCE, Predictor
from service.model.push_cost import PushCost
from service.model.tensors import FloatArray

MAX_BYTES: Final = 128 << 20  # of all tensors, for all rows and contexts in one call
_MEASUREMENTS: Final = 3  # the lowest counts: the first call of a session is slower, and another may be interrupted
_LONG_S: Final = 0.1  # a longer check is not repeated, since its time is known well enough


def measure_cost(manifest: Manifest, predictor: Predictor) -> PushCost:
    """Run the self-check, and return the cost of pushes that follows from its time.

    Raises:
        BrokenModelError: see ``check_itself``.
    """
    seconds = check_itself(manifest, predictor)
    for _ in range(_MEASUREMENTS - 1 if seconds < _LONG_S else 0):
        seconds = min(seconds, check_itself(manifest, predictor))
    check = manifest.self_check
    pushes = -(-len(check.pusher) // ROWS_AT_ONCE) * ROWS_AT_ONCE  # a call computes this many at least
    return PushCost(pushes, max(1, len(check.context)), seconds)


def check_itself(manifest: Manifest, predictor: Predictor) -> float:
    """Predict the stored input and compare the result with the stored output. Return the time of the call, in s.

    Raises:
        BrokenModelError: the output differs by more than the stored tolerance, or the input cannot be run.
    """
    check = manifest.self_check
    try:
        rows = np.array(check.pusher, dtype=np.float32)
        contexts = stored_contexts(manifest)
        index = np.array(check.context_index, dtype=np.int64) if contexts else None
        size = predictor.size
        if len(rows) * size.row_bytes + (len(check.context) if contexts else 0) * size.context_bytes > MAX_BYTES:
            raise BrokenModelError(f"self-check: it takes more than {MAX_BYTES} bytes of memory; store fewer rows")
        began = time.perf_counter()
        mean, std, _ = predictor.predict(rows, contexts, index)
        seconds = time.perf_counter() - began
        found, expected = np.stack([mean, std]), np.array([check.mean, check.std], dtype=np.float32)
    except BrokenModelError:
        raise
    except (ValueError, CazslError) as error:
        raise BrokenModelError("self-check: the stored input cannot be run") from error
    if found.shape != expected.shape or not np.allclose(found, expected, rtol=0.0, atol=check.tolerance):
        raise BrokenModelError(f"self-check: the output differs by more than {check.tolerance} from the stored one")
    return seconds


def flattened(contexts: tuple[FloatArray, ...]) -> list[list[float]]:
    """Return contexts as a manifest stores them: the numbers of each, one tensor after the other."""
    if not contexts:
        return []
    rows: list[list[float]] = np.hstack([tensor.reshape(len(tensor), -1) for tensor in contexts]).tolist()
    return rows


def stored_contexts(manifest: Manifest) -> tuple[FloatArray, ...]:
    """Return the contexts of the self-check, (g, ...) for each tensor of a context.

    Raises:
        ValueError: a row does not hold the numbers of these tensors.
    """
    _, *tensors = manifest.inputs
    if not tensors:
        return ()
    shapes = [tuple(map(int, tensor.shape[1:])) for tensor in tensors[:-1]]  # without the index of contexts
    rows = np.array(manifest.self_check.context, dtype=np.float32).reshape(-1, sum(map(math.prod, shapes)))
    parts = np.split(rows, np.cumsum([math.prod(shape) for shape in shapes])[:-1], axis=1)
    return tuple(part.reshape(-1, *shape) for part, shape in zip(parts, shapes, strict=True))
