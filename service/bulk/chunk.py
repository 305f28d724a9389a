"""A chunk of many pushes in columns: validation of its rows, and their predictions.

Rows follow the rules of a request: numbers are finite, pushers are within reach and start outside of a shape, contexts
are valid. A chunk is cut after a fixed number of rows, whatever executor predicts it, so results do not depend on the
executor.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from service.errors import FieldFault, InvalidRequestError, RequestError
from service.inference.pushes import PushFields, push_rows, reach_m
from service.inference.query import ContextBatch, predict
from service.model.loaded_model import LoadedModel
from service.model.manifest import Manifest
from service.model.predictor import OnnxPredictor
from service.model.self_check import measure_cost
from service.model.tensors import ContextKind, FloatArray, IndexArray
from service.pushing.contexts import ObjectContext, VisualContext
from service.pushing.poses import MAX_LENGTH_M, DoubleArray, unreachable, wrap_angles
from service.pushing.shape_context import ShapeContext
from service.schemas.body import parse_body
from service.schemas.contexts import ContextBody

POSE_COLUMNS: Final = ("x_m", "y_m", "angle_rad")
LENGTH_COLUMN: Final = "length_m"  # may be left out: every push is one of ``PUSH_LENGTH_M``
PUSH_COLUMNS: Final = (*POSE_COLUMNS, LENGTH_COLUMN)
CONTEXT_COLUMNS: Final = {
    ContextKind.INDICATOR: "descriptor",
    ContextKind.VISUAL: "visual",
    ContextKind.SHAPE: "context",
}
PREDICTED_COLUMNS: Final = ("mean_x_m", "mean_y_m", "mean_angle_rad", "std_x_m", "std_y_m", "std_angle_rad")
CHUNK_ROWS: Final = 8192
CONTEXT_FIELD: Final = "column of contexts"
_ROW: Final = "row {row} (counted from 0), column "
_SHAPE: Final = 'a shape, such as {"outline": [[0.06, 0.04], [-0.06, 0.04], [0.0, -0.05]]}'


@dataclass(frozen=True)
class Chunk:
    """Consecutive rows of a table."""

    first_row: int
    pushes: DoubleArray  # (n, 4) poses in the object frame, and lengths in m. NaN for empty cells
    empty: npt.NDArray[np.bool_]  # (n, 4), True for empty cells
    contexts: tuple[str | bytes | None, ...]  # distinct descriptors, visual contexts or JSON of shapes, None if empty
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
    tensors, context_fault = _contexts(kind, chunk)
    push_fault = _push_fault(chunk, reach_m(kind))
    if fault := min(filter(None, (push_fault, context_fault)), key=lambda each: each[0], default=None):
        raise InvalidRequestError([fault[1]])
    poses, lengths_m = chunk.pushes[:, :3].copy(), chunk.pushes[:, 3]
    poses[:, 2] = wrap_angles(poses[:, 2])
    contexts = ContextBatch(kind, tensors, chunk.context_index, CONTEXT_FIELD)
    fields = PushFields(_ROW + POSE_COLUMNS[0], _ROW + LENGTH_COLUMN, chunk.first_row)
    found = predict(model, push_rows(model, poses, lengths_m, contexts, fields), contexts)
    return np.hstack([found.mean, found.std])


def _push_fault(chunk: Chunk, most_m: float) -> tuple[int, FieldFault] | None:
    """Return the first row with an invalid pose or length and its fault, or None."""
    good = np.isfinite(chunk.pushes)
    good[:, :2] &= np.abs(chunk.pushes[:, :2]) <= most_m
    good[:, 3] &= (chunk.pushes[:, 3] > 0.0) & (chunk.pushes[:, 3] <= MAX_LENGTH_M)
    if good.all():
        return None
    row, column = (int(place) for place in np.argwhere(~good)[0])
    where, value = _where(chunk, row, PUSH_COLUMNS[column]), float(chunk.pushes[row, column])
    if chunk.empty[row, column]:
        return row, FieldFault(where, "an empty cell", "a finite number")
    if not np.isfinite(value):
        return row, FieldFault(where, str(value), "a finite number")
    if PUSH_COLUMNS[column] == LENGTH_COLUMN:
        return row, FieldFault(where, f"{value:.6g} m", f"above 0, to {MAX_LENGTH_M:g} m")
    return row, unreachable(where, value, most_m)


def _contexts(kind: ContextKind, chunk: Chunk) -> tuple[tuple[FloatArray, ...], tuple[int, FieldFault] | None]:
    """Return the distinct contexts as tensors, or the first row with an invalid context and its fault."""
    if chunk.context_index is None:
        return (), None
    found: list[tuple[FloatArray, ...]] = []
    for number, given in enumerate(
        chunk.contexts
    ):  # in order of appearance, so the first fault is in the first invalid row
        row = int(np.argmax(chunk.context_index == number))
        where = _where(chunk, row, CONTEXT_COLUMNS[kind])
        try:
            found.append(_tensors(kind, given, where))
        except InvalidRequestError as error:
            return (), (row, error.faults[0])
    return tuple(map(np.stack, zip(*found, strict=True))), None


def _tensors(kind: ContextKind, given: str | bytes | None, where: str) -> tuple[FloatArray, ...]:
    match given:
        case str() if kind is ContextKind.SHAPE:
            return _shape(given, where).tensors()
        case str():
            return (ObjectContext.from_descriptor(given, where).tensor(),)
        case bytes():
            return (VisualContext.from_bytes(given, where).tensor(),)
        case None:
            raise InvalidRequestError.at(where, "an empty cell", "an object in every row")


def _shape(given: str, where: str) -> ShapeContext:
    """Return the shape of a context in JSON, as requests have it.

    Raises:
        InvalidRequestError: it is not JSON, not valid, or no shape.
    """
    try:
        found = parse_body(ContextBody, given.encode(), (where,)).to_domain(where)
    except InvalidRequestError:
        raise
    except RequestError as error:
        raise InvalidRequestError.at(where, "a text that is no context in JSON", _SHAPE) from error
    if isinstance(found, ShapeContext):
        return found
    raise InvalidRequestError.at(where, f"a context of kind {found.kind}", _SHAPE)


def _where(chunk: Chunk, row: int, column: str) -> str:
    return _ROW.format(row=chunk.first_row + row) + column
