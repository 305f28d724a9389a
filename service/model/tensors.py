"""Arrays and tensors of a model, and the kinds of object context that a model may take."""

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
import numpy.typing as npt


@dataclass(frozen=True)
class Tensor:
    """One input or output of the graph; a text in the shape is a free dimension."""

    name: str
    dtype: str
    shape: tuple[int | str, ...]
    units: tuple[str, ...]


FloatArray = npt.NDArray[np.float32]
IndexArray = npt.NDArray[np.int64]


class ContextKind(StrEnum):
    """What a model wants to know about the object."""

    NONE = "none"
    INDICATOR = "indicator"
    VISUAL = "visual"
