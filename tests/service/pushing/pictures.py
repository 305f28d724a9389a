"""Pictures in memory for the tests of images, and their visual contexts as arrays."""

import numpy as np
import numpy.typing as npt

from service.pushing.contexts import VISUAL_SIZE, VisualContext

Grey = npt.NDArray[np.uint8]


def noise(height: int, width: int, seed: int = 0) -> Grey:
    """Return a picture of random grey levels."""
    return np.random.default_rng(seed).integers(0, 256, (height, width), dtype=np.uint8)


def cells(context: VisualContext) -> Grey:
    """Return the grey levels of a visual context, [32, 32]."""
    return np.frombuffer(context.levels, dtype=np.uint8).reshape(VISUAL_SIZE, VISUAL_SIZE)
