"""A chunk of many pushes in columns: what it is, which of its rows cannot be, and its predictions.

Rows follow the rules of a request: numbers finite, pushers within reach, objects that can be. Chunks are cut by rows
alone, never by who does them.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from service.errors import FieldFault, InvalidRequestError
from service.model.loaded_model import LoadedModel
from service.model.manifest import Manifest
from service.model.predictor import OnnxPredictor
from service.model.self_check import check_itself
from service.model.tensors import ContextKind, FloatArray, IndexArray
from service.pushing.contexts import ObjectContext, VisualContext
from service.pushing.poses import REACH_M, DoubleArray, unreachable, wrap_angles

POSE_COLUMNS: Final = ("x_m", "y_m", "angle_rad")
CONTEXT_COLUMNS: Final = {ContextKind.INDICATOR: "descriptor", ContextKind.VISUAL: "visual"}
PREDICTED_COLUMNS: Final = ("mean_x_m", "mean_y_m", "mean_angle_rad", "std_x_m", "std_y_m", "std_angle_rad")
CHUNK_ROWS: Final = 8192


@dataclass(frozen=True)
class Chunk:
    """Consecutive rows of a table."""

    first_row: int
    poses: DoubleArray  # (n, 3) in the object frame; NaN where nothing stands
    empty: npt.NDArray[np.bool_]  # (n, 3): where nothing stands
    objects: tuple[str | bytes | None, ...]  # distinct descriptors or visual contexts, None where nothing stands
    places: IndexArray | None  # (n,): which of the objects each push meets; None for models without context


@dataclass(frozen=True)
class ModelParts:
    """A verified version on its way to whoever predicts with it."""

    manifest: Manifest
    model: bytes

    def load(self) -> LoadedModel:
        """The model in memory, checked there too: another machine may have another runtime.

        Raises:
            BrokenModelError: it fails its self-check.
        """
        predictor = OnnxPredictor(self.model, self.manifest.context_kind)
        check_itself(self.manifest, predictor)
        return LoadedModel(self.manifest, "", predictor)


def predict_chunk(model: LoadedModel, chunk: Chunk) -> FloatArray:
    """Mean and std of each push side by side, (n, 6), in the order of ``PREDICTED_COLUMNS``.

    Raises:
        InvalidRequestError: names the first row that cannot be, its column, what stands there and what may.
        PredictionError: the runtime failed.
    """
    kind = model.manifest.context_kind
    contexts, wrong_object = _contexts(kind, chunk)
    wrong_pose = _wrong_pose(chunk)
    if wrong := min(filter(None, (wrong_pose, wrong_object)), key=lambda each: each[0], default=None):
        raise InvalidRequestError([wrong[1]])
    pushers: FloatArray = chunk.poses.astype(np.float32)
    pushers[:, 2] = wrap_angles(chunk.poses[:, 2])
    mean, std = model.predict(pushers, kind, contexts, chunk.places)
    return np.hstack([mean, std])


def _wrong_pose(chunk: Chunk) -> tuple[int, FieldFault] | None:
    """The first row with a pose that cannot be, and what is wrong with it."""
    good = np.isfinite(chunk.poses)
    good[:, :2] &= np.abs(chunk.poses[:, :2]) <= REACH_M
    if good.all():
        return None
    row, column = (int(place) for place in np.argwhere(~good)[0])
    where, value = _where(chunk, row, POSE_COLUMNS[column]), float(chunk.poses[row, column])
    if chunk.empty[row, column]:
        return row, FieldFault(where, "nothing", "a finite number")
    if not np.isfinite(value):
        return row, FieldFault(where, str(value), "a finite number")
    return row, unreachable(where, value)


def _contexts(kind: ContextKind, chunk: Chunk) -> tuple[FloatArray | None, tuple[int, FieldFault] | None]:
    """The distinct objects as the model takes them; or the first row whose object cannot be, and why."""
    if chunk.places is None:
        return None, None
    tensors = []
    for number, given in enumerate(chunk.objects):  # by first appearance, so the first wrong one is in the first row
        row = int(np.argmax(chunk.places == number))
        where = _where(chunk, row, CONTEXT_COLUMNS[kind])
        try:
            tensors.append(_object(given, where).tensor())
        except InvalidRequestError as error:
            return None, (row, error.faults[0])
    return np.stack(tensors), None


def _object(given: str | bytes | None, where: str) -> ObjectContext | VisualContext:
    match given:
        case str():
            return ObjectContext.from_descriptor(given, where)
        case bytes():
            return VisualContext.from_bytes(given, where)
        case None:
            raise InvalidRequestError.at(where, "nothing", "an object in every row")


def _where(chunk: Chunk, row: int, column: str) -> str:
    return f"row {chunk.first_row + row} (counted from 0), column {column}"
