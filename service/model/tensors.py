"""Tensors of a graph, their size in sum, the array types that hold them, and the kinds of object context."""

from dataclasses import dataclass
from enum import StrEnum
from itertools import repeat
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float32]
IndexArray = npt.NDArray[np.int64]


class Gaussians(NamedTuple):
    """Predictions of some rows: independent Gaussians, and how far each row is from those that a version knows."""

    mean: FloatArray
    """(n, outputs) float32."""
    std: FloatArray
    """(n, outputs) float32, positive."""
    unfamiliarity: FloatArray | None = None
    """(n, 2) float32, distances of push and object, above 1 outside of the domain. None: the version has none."""

    def rows(self, part: slice) -> "Gaussians":
        """Return the predictions of some of the rows."""
        known = self.unfamiliarity
        return Gaussians(self.mean[part], self.std[part], None if known is None else known[part])

    def each(self) -> list["Gaussians"]:
        """Return the predictions of each row alone."""
        known = repeat(None) if self.unfamiliarity is None else self.unfamiliarity[:, None]
        return list(map(Gaussians, self.mean[:, None], self.std[:, None], known))


class ContextKind(StrEnum):
    """Kind of object context that a model takes."""

    NONE = "none"
    INDICATOR = "indicator"
    VISUAL = "visual"
    SHAPE = "shape"
    SUPPORT = "support"


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
