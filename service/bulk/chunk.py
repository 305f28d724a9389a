"""A chunk of many pushes in columns: validation of its rows, and their predictions.

Rows follow the rules of a request: numbers are finite, pushers are within reach and start outside of a shape, contexts
are valid. A chunk is cut after a fixed number of rows, whatever executor predicts it, so results do not depend on the
executor.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

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
from service.pushing.contexts import ObjectContext, SupportContext, VisualContext
from service.pushing.image_quality import QualityFlag
from service.pushing.poses import MAX_LENGTH_M, DoubleArray, unreachable, wrap_angles
from service.pushing.shape_context import ShapeContext
from service.schemas.body import parse_body
from service.schemas.contexts import ContextBody
from service.schemas.supports import SupportBody
from service.validity.codes import AnswerWarning
from service.validity.judging import find_warnings

POSE_COLUMNS: Final = ("x_m", "y_m", "angle_rad")
LENGTH_COLUMN: Final = "length_m"  # may be left out: every push is one of ``PUSH_LENGTH_M``
PUSH_COLUMNS: Final = (*POSE_COLUMNS, LENGTH_COLUMN)
CONTEXT_COLUMNS: Final = {
    ContextKind.INDICATOR: "descriptor",
    ContextKind.VISUAL: "visual",
    ContextKind.SHAPE: "context",
    ContextKind.SUPPORT: "support",
}
NUMBER_COLUMNS: Final = ("mean_x_m", "mean_y_m", "mean_angle_rad", "std_x_m", "std_y_m", "std_angle_rad")
WARNINGS_COLUMN: Final = "warnings"
PREDICTED_COLUMNS: Final = (*NUMBER_COLUMNS, WARNINGS_COLUMN)
CHUNK_ROWS: Final = 8192
CONTEXT_FIELD: Final = "column of contexts"
Flags = tuple[QualityFlag, ...]
_ROW: Final = "row {row} (counted from 0), column "
_SUPPORT: Final = 'a support, such as {"pushers": [[-0.075, 0, 0]], "outcomes": [[0.02, 0, 0]]}'
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


class ChunkPredictions(NamedTuple):
    """Predictions of n pushes."""

    numbers: FloatArray
    """(n, 6) mean and std, in the order of ``NUMBER_COLUMNS``."""
    warnings: list[str]
    """Codes of the warnings of each push, with spaces between them."""


def predict_chunk(model: LoadedModel, chunk: Chunk) -> ChunkPredictions:
    """Predict mean and std of each push, with warnings.

    Raises:
        InvalidRequestError: a row is invalid. Names the first one, its column, the value and the accepted values.
        PredictionError: the runtime failed.
    """
    kind = model.manifest.context_kind
    tensors, flags, context_fault = _contexts(kind, chunk)
    push_fault = _push_fault(chunk, reach_m(kind))
    if fault := min(filter(None, (push_fault, context_fault)), key=lambda each: each[0], default=None):
        raise InvalidRequestError([fault[1]])
    poses, lengths_m = chunk.pushes[:, :3].copy(), chunk.pushes[:, 3]
    poses[:, 2] = wrap_angles(poses[:, 2])
    contexts = ContextBatch(kind, tensors, chunk.context_index, CONTEXT_FIELD, flags)
    fields = PushFields(_ROW + POSE_COLUMNS[0], _ROW + LENGTH_COLUMN, chunk.first_row)
    rows = push_rows(model, poses, lengths_m, contexts, fields)
    found = predict(model, rows, contexts)
    warnings = find_warnings(model.manifest, rows, ((POSE_COLUMNS[2], chunk.pushes[:, 2]),), contexts, found)
    return ChunkPredictions(np.hstack([found.mean, found.std]), _codes(warnings, len(rows)))


def _codes(warnings: Sequence[AnswerWarning], count: int) -> list[str]:
    found: list[list[str]] = [[] for _ in range(count)]
    for warning in warnings:
        for row in warning.rows:
            found[row].append(warning.code)
    return [" ".join(codes) for codes in found]


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


def _contexts(
    kind: ContextKind, chunk: Chunk
) -> tuple[tuple[FloatArray, ...], tuple[Flags, ...], tuple[int, FieldFault] | None]:
    """Return the distinct contexts as tensors with the faults of photographs, or the first row with an invalid one."""
    if chunk.context_index is None:
        return (), (), None
    flags: list[Flags] = []
    found: list[tuple[FloatArray, ...]] = []
    for number, given in enumerate(
        chunk.contexts
    ):  # in order of appearance, so the first fault is in the first invalid row
        row = int(np.argmax(chunk.context_index == number))
        where = _where(chunk, row, CONTEXT_COLUMNS[kind])
        try:
            tensors, of_one = _tensors(kind, given, where)
        except InvalidRequestError as error:
            return (), (), (row, error.faults[0])
        found.append(tensors)
        flags.append(of_one)
    return tuple(map(np.stack, zip(*found, strict=True))), tuple(flags), None


def _tensors(kind: ContextKind, given: str | bytes | None, where: str) -> tuple[tuple[FloatArray, ...], Flags]:
    match given:
        case str() if kind is ContextKind.SHAPE:
            shape, flags = _shape(given, where)
            return shape.tensors(), flags
        case str() if kind is ContextKind.SUPPORT:
            return _support(given, where).tensors(), ()
        case str():
            return (ObjectContext.from_descriptor(given, where).tensor(),), ()
        case bytes():
            return (VisualContext.from_bytes(given, where).tensor(),), ()
        case None:
            raise InvalidRequestError.at(where, "an empty cell", "an object in every row")


def _shape(given: str, where: str) -> tuple[ShapeContext, Flags]:
    """Return the shape of a context in JSON, as requests have it, and the faults of its photograph.

    Raises:
        InvalidRequestError: it is not JSON, not valid, or no shape.
    """
    try:
        found, flags = parse_body(ContextBody, given.encode(), (where,)).describe(where)
    except InvalidRequestError:
        raise
    except RequestError as error:
        raise InvalidRequestError.at(where, "a text that is no context in JSON", _SHAPE) from error
    if isinstance(found, ShapeContext):
        return found, flags
    raise InvalidRequestError.at(where, f"a context of kind {found.kind}", _SHAPE)


def _support(given: str, where: str) -> SupportContext:
    """Return the support of a text in JSON, as requests have it.

    Raises:
        InvalidRequestError: it is not JSON, or not valid.
    """
    try:
        return parse_body(SupportBody, given.encode(), (where,)).to_domain(where)
    except InvalidRequestError:
        raise
    except RequestError as error:
        raise InvalidRequestError.at(where, "a text that is no support in JSON", _SUPPORT) from error


def _where(chunk: Chunk, row: int, column: str) -> str:
    return _ROW.format(row=chunk.first_row + row) + column
