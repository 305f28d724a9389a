"""Pushes as rows of a model: poses with the lengths that the model knows, each from outside of its object."""

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from service.errors import InvalidRequestError
from service.inference.query import ContextBatch
from service.model.loaded_model import LoadedModel
from service.model.tensors import ContextKind, FloatArray, IndexArray
from service.pushing.poses import PUSH_LENGTH_M, REACH_M, DoubleArray
from service.pushing.shape_context import SHAPE_REACH_M

_OUTLINE: Final = 1  # among the tensors of a shape
_SAME_M: Final = 1e-6  # lengths that differ less are equal
_PAIRS: Final = 1 << 16  # of a push and an edge of its object, at a time


@dataclass(frozen=True, slots=True)
class PushFields:
    """Fields of a request that have a push and its length, for errors.

    Attributes:
        push: field of a push, where ``{row}`` stands for its row.
        length: field of its length, likewise.
        first_row: number of the first row.
    """

    push: str
    length: str
    first_row: int = 0

    def of_push(self, row: int) -> str:
        """Return the field of a push."""
        return self.push.format(row=self.first_row + row)

    def of_length(self, row: int) -> str:
        """Return the field of the length of a push."""
        return self.length.format(row=self.first_row + row)


def reach_m(kind: ContextKind) -> float:
    """Return how far a pusher may be from the origin of the object frame, which of a shape is the caller's."""
    return SHAPE_REACH_M if kind is ContextKind.SHAPE else REACH_M


def push_rows(
    model: LoadedModel,
    poses: DoubleArray,
    lengths_m: DoubleArray,
    contexts: ContextBatch,
    fields: PushFields,
) -> FloatArray:
    """Return pushes as rows of a model: (n, 4) x_m, y_m, angle_rad, length_m, or (n, 3) if it knows one length.

    Args:
        model: the model.
        poses: (n, 3) in the object frame.
        lengths_m: (1,) of every push, or (n,).
        contexts: the objects of the pushes.
        fields: fields of a push, for errors.

    Raises:
        InvalidRequestError: a length is none that the model knows, or a pusher starts inside of a shape.
    """
    if contexts.kind is ContextKind.SHAPE and contexts.index is not None:
        inside = starts_inside(contexts.tensors[_OUTLINE], contexts.index, poses)
        if inside.any():
            row = int(inside.argmax())
            received = f"a pusher that starts inside of the object, at x {poses[row, 0]:.6g} m, y {poses[row, 1]:.6g} m"
            raise InvalidRequestError.at(fields.of_push(row), received, "a start outside of its outline")
    if model.manifest.context_kind is ContextKind.SHAPE:
        rows = np.empty((len(poses), 4), dtype=np.float32)
        rows[:, :3], rows[:, 3] = poses, lengths_m
        return rows
    if lengths_m.tolist() != [PUSH_LENGTH_M] and (other := np.abs(lengths_m - PUSH_LENGTH_M) > _SAME_M).any():
        row = int(other.argmax())
        accepted = f"{PUSH_LENGTH_M:g} m, the only length that {model.manifest.name} knows; send the object's outline "
        accepted += "as context, for models of shapes know others"
        raise InvalidRequestError.at(fields.of_length(row), f"{lengths_m[row]:.6g} m", accepted)
    return poses.astype(np.float32)


def starts_inside(outlines: FloatArray, index: IndexArray, poses: DoubleArray) -> npt.NDArray[np.bool_]:
    """Return (n,) true for the poses (n, 3) whose point is inside of outline ``outlines[index]``, (g, c, 2).

    A ray from an inner point along the x axis crosses an odd number of edges. A point on the outline may count as
    either.
    """
    inside = np.empty(len(poses), dtype=np.bool_)
    step = max(1, _PAIRS // outlines.shape[1])
    for first in range(0, len(poses), step):
        rows = slice(first, first + step)
        corners = outlines[index[rows]]
        closed = np.concatenate((corners, corners[:, :1]), axis=1) - poses[rows, None, :2]  # in float64
        x, y = closed[..., 0], closed[..., 1]
        low = y <= 0.0
        left = x[:, :-1] * y[:, 1:] > x[:, 1:] * y[:, :-1]  # the point is on the left of the edge
        crossed = (low[:, :-1] != low[:, 1:]) & (left == low[:, :-1])  # an edge that rises has the point on its left
        inside[rows] = np.count_nonzero(crossed, axis=1) % 2 == 1
    return inside
