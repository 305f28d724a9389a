"""Tensors of a graph, their size in sum, the array types that hold them, and the kinds of object context."""

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float32]
IndexArray = npt.NDArray[np.int64]


class ContextKind(StrEnum):
    """Kind of object context that a model takes."""

    NONE = "none"
    INDICATOR = "indicator"
    VISUAL = "visual"
    SHAPE = "shape"


@dataclass(frozen=True)
class Tensor:
    """One input or output of a graph. A text in the shape is a free dimension."""

    name: str
    dtype: str
    shape: tuple[int | str, ...]
    units: tuple[str, ...]


@dataclass(frozen=True)
class GraphSize:
    """Bytes of the intermediate tensors of a graph: the sums for one more row, and for one more context."""

    row_bytes: int = 0
    context_bytes: int = 0
