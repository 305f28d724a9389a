"""Self-check of a version: a stored input, and the stored output that the predictor must give for it.

The check is also the measurement of the version's cost.
"""

import time
from typing import Final

import numpy as np

from service.errors import BrokenModelError, CazslError
from service.model.manifest import Manifest
from service.model.predictor import ROWS_AT_ONCE, Predictor
from service.model.push_cost import PushCost

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
        context, index = None, None
        if len(manifest.inputs) > 1:
            _, *shape = manifest.inputs[1].shape  # the manifest stores each context as one row of numbers
            context = np.array(check.context, dtype=np.float32).reshape(-1, *map(int, shape))
            index = np.array(check.context_index, dtype=np.int64)
        size = predictor.size
        if len(rows) * size.row_bytes + (0 if context is None else len(context)) * size.context_bytes > MAX_BYTES:
            raise BrokenModelError(f"self-check: it takes more than {MAX_BYTES} bytes of memory; store fewer rows")
        began = time.perf_counter()
        found = np.stack(predictor.predict(rows, context, index))
        seconds = time.perf_counter() - began
        expected = np.array([check.mean, check.std], dtype=np.float32)
    except BrokenModelError:
        raise
    except (ValueError, CazslError) as error:
        raise BrokenModelError("self-check: the stored input cannot be run") from error
    if found.shape != expected.shape or not np.allclose(found, expected, rtol=0.0, atol=check.tolerance):
        raise BrokenModelError(f"self-check: the output differs by more than {check.tolerance} from the stored one")
    return seconds
