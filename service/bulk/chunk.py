"""A chunk of many pushes in columns: validation of its rows, and their predictions.

Rows follow the rules of a request: numbers are finite, pushers are within reach, contexts are valid. A chunk is cut
after a fixed number of rows, whatever executor predicts it, so results do not depend on the executor.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from service.errors import FieldFault, InvalidRequestError
from service.inference.query import ContextBatch, predict
from service.model.loaded_model import LoadedModel
from service.model.manifest import Manifest
from service.model.predictor import OnnxPredictor
from service.model.self_check import measure_cost
from service.model.tensors import ContextKind, FloatArray, IndexArray
from service.pushing.contexts import ObjectContext, VisualContext
from service.pushing.poses import REACH_M, DoubleArray, unreachable, wrap_angles

POSE_COLUMNS: Final = ("x_m", "y_m", "angle_rad")
CONTEXT_COLUMNS: Final = {ContextKind.INDICATOR: "descriptor", ContextKind.VISUAL: "visual"}
PREDICTED_COLUMNS: Final = ("mean_x_m", "mean_y_m", "mean_angle_rad", "std_x_m", "std_y_m", "std_angle_rad")
CHUNK_ROWS: Final = 8192
CONTEXT_FIELD: Final = "column of contexts"


@dataclass(frozen=True)
class Chunk:
    """Consecutive rows of a table."""

    first_row: int
    poses: DoubleArray  # (n, 3) in the object frame, NaN for empty cells
    empty: npt.NDArray[np.bool_]  # (n, 3), True for empty cells
    contexts: tuple[str | bytes | None, ...]  # distinct descriptors or visual contexts, None for empty cells
    context_index: IndexArray | None  # (n,) index of each push into ``contexts``. None for models without context


@dataclass(frozen=True)
class ModelParts:
    """A verified version, as it is sent to the workers."""

    manifest: Manifest
    model: bytes

    def load(self) -> LoadedModel:
        """Load the model and run its self-check, because a worker's machine may have another runtime.

        Raises:
            BrokenModelError: the model cannot be loaded, or fails its self-check.
        """
        predictor = OnnxPredictor(self.model, self.manifest.inputs, self.manifest.outputs)
        return LoadedModel(self.manifest, "", predictor, measure_cost(self.manifest, predictor))


def predict_chunk(model: LoadedModel, chunk: Chunk) -> FloatArray:
    """Predict mean and std of each push, (n, 6), in the order of ``PREDICTED_COLUMNS``.

    Raises:
        InvalidRequestError: a row is invalid. Names the first one, its column, the value and the accepted values.
        PredictionError: the runtime failed.
    """
    kind = model.manifest.context_kind
    contexts, context_fault = _contexts(kind, chunk)
    pose_fault = _pose_fault(chunk)
    if fault := min(filter(None, (pose_fault, context_fault)), key=lambda each: each[0], default=None):
        raise InvalidRequestError([fault[1]])
    pushers: FloatArray = chunk.poses.astype(np.float32)
    pushers[:, 2] = wrap_angles(chunk.poses[:, 2])
    found = predict(model, pushers, ContextBatch(kind, contexts, chunk.context_index, CONTEXT_FIELD))
    return np.hstack([found.mean, found.std])


def _pose_fault(chunk: Chunk) -> tuple[int, FieldFault] | None:
    """Return the first row with an invalid pose and its fault, or None."""
    good = np.isfinite(chunk.poses)
    good[:, :2] &= np.abs(chunk.poses[:, :2]) <= REACH_M
    if good.all():
        return None
    row, column = (int(place) for place in np.argwhere(~good)[0])
    where, value = _where(chunk, row, POSE_COLUMNS[column]), float(chunk.poses[row, column])
    if chunk.empty[row, column]:
        return row, FieldFault(where, "an empty cell", "a finite number")
    if not np.isfinite(value):
        return row, FieldFault(where, str(value), "a finite number")
    return row, unreachable(where, value)


def _contexts(kind: ContextKind, chunk: Chunk) -> tuple[tuple[FloatArray, ...], tuple[int, FieldFault] | None]:
    """Return the distinct contexts as tensors, or the first row with an invalid context and its fault."""
    if chunk.context_index is None:
        return (), None
    tensors = []
    for number, given in enumerate(
        chunk.contexts
    ):  # in order of appearance, so the first fault is in the first invalid row
        row = int(np.argmax(chunk.context_index == number))
        where = _where(chunk, row, CONTEXT_COLUMNS[kind])
        try:
            tensors.append(_parse_context(given, where).tensor())
        except InvalidRequestError as error:
            return (), (row, error.faults[0])
    return (np.stack(tensors),), None


def _parse_context(given: str | bytes | None, where: str) -> ObjectContext | VisualContext:
    match given:
        case str():
            return ObjectContext.from_descriptor(given, where)
        case bytes():
            return VisualContext.from_bytes(given, where)
        case None:
            raise InvalidRequestError.at(where, "an empty cell", "an object in every row")


def _where(chunk: Chunk, row: int, column: str) -> str:
    return f"row {chunk.first_row + row} (counted from 0), column {column}"
