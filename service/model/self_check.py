"""A stored input and the output that belongs to it: the proof that a model is what was published, and still answers."""

import numpy as np

from service.errors import BrokenModelError, CazslError
from service.model.manifest import Manifest
from service.model.predictor import Predictor
from service.pushing.contexts import VISUAL_SIZE, ContextKind


def check_itself(manifest: Manifest, predictor: Predictor) -> None:
    """Run the stored input and compare with the stored output.

    Raises:
        BrokenModelError: it gives something else.
    """
    check = manifest.self_check
    try:
        pusher = np.array(check.pusher, dtype=np.float32)
        context = np.array(check.context, dtype=np.float32)
        if manifest.context_kind is ContextKind.VISUAL:
            context = context.reshape(-1, 1, VISUAL_SIZE, VISUAL_SIZE)
        index = np.array(check.context_index, dtype=np.int64)
        found = np.stack(predictor.predict(pusher, context, index))
        expected = np.array([check.mean, check.std], dtype=np.float32)
    except (ValueError, CazslError) as error:
        raise BrokenModelError("self-check: the stored input cannot be run") from error
    if found.shape != expected.shape or not np.allclose(found, expected, rtol=0.0, atol=check.tolerance):
        raise BrokenModelError(f"self-check: the output differs by more than {check.tolerance} from the stored one")
