"""Self-check of a version: a stored input, and the stored output that the predictor must give for it."""

import numpy as np

from service.errors import BrokenModelError, CazslError
from service.model.manifest import Manifest
from service.model.predictor import Predictor


def check_itself(manifest: Manifest, predictor: Predictor) -> None:
    """Predict the stored input and compare the result with the stored output.

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
        found = np.stack(predictor.predict(rows, context, index))
        expected = np.array([check.mean, check.std], dtype=np.float32)
    except (ValueError, CazslError) as error:
        raise BrokenModelError("self-check: the stored input cannot be run") from error
    if found.shape != expected.shape or not np.allclose(found, expected, rtol=0.0, atol=check.tolerance):
        raise BrokenModelError(f"self-check: the output differs by more than {check.tolerance} from the stored one")
