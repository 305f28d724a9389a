"""A query: pushes and contexts for one model, and the bytes of its answer.

Queries of every protocol pass through ``predict``.
"""

import math
import time
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Final

import numpy as np

from service.errors import ContextKindError
from service.inference.pieces import predict_in_pieces
from service.model.loaded_model import LoadedModel
from service.model.tensors import ContextKind, FloatArray, Gaussians, IndexArray
from service.observability.timings import record_timing
from service.pushing.image_quality import QualityFlag
from service.pushing.poses import wrap_angles
from service.validity.codes import Angles, AnswerWarning
from service.validity.judging import find_warnings

FIRST_CONTEXT: Final = np.zeros(1, dtype=np.int64)
Warnings = tuple[AnswerWarning, ...]
_LARGEST_ANGLE: Final = float(np.nextafter(np.float32(math.pi), np.float32(0.0)))  # float32's pi is beyond pi
_FEW: Final = 64  # rows that plain numbers check faster than numpy


@dataclass(frozen=True, slots=True)
class Answer:
    """An answer: its bytes and headers, and for predictions the model and the number of pushes."""

    content: bytes
    model: str = ""
    version: int = 0
    pushes: int = 0
    headers: tuple[tuple[bytes, bytes], ...] = ((b"content-type", b"application/json"),)

    def head(self) -> tuple[tuple[bytes, bytes], ...]:
        """Return all headers, in the order of the framework."""
        return (*self.headers, (b"content-length", b"%d" % len(self.content)))


@dataclass(frozen=True, slots=True)
class ContextBatch:
    """Distinct contexts of one kind, and the index of each push's context.

    Attributes:
        kind: kind of every context in the batch.
        tensors: (g, ...) float32 each, the distinct contexts in the order of a model's inputs. Empty for kind ``none``.
        index: (n,) int64, the context of each push. None for kind ``none``.
        where: field of the request that has the contexts, for errors.
        flags: faults of the photograph of each context, if they are shapes from photographs. Views are judged later.
    """

    kind: ContextKind
    tensors: tuple[FloatArray, ...]
    index: IndexArray | None
    where: str
    flags: tuple[tuple[QualityFlag, ...], ...] = ()

    @property
    def count(self) -> int:
        """Return the number of distinct contexts."""
        return len(self.tensors[0]) if self.tensors else 0


def predict(model: LoadedModel, pushers: FloatArray, contexts: ContextBatch) -> Gaussians:
    """Return the Gaussians of pushes (n, 3 or 4), in m, m, rad in the object frame, with angles in (-pi, pi].

    Raises:
        ContextKindError: the contexts are not of the kind that the model takes.
        PredictionError: the runtime failed.
        DeadlineError: the answer is late or no longer wanted (in a thread of ``transport.threads`` only).
    """
    manifest = model.manifest
    if contexts.kind is not manifest.context_kind:
        accepted = f"a context of kind {manifest.context_kind} for {manifest.name}"
        raise ContextKindError.at(contexts.where, f"kind {contexts.kind}", accepted)
    began = time.perf_counter()
    tensors = contexts.tensors
    if len(pushers) == 1 and (not tensors or len(tensors[0]) == 1):
        found = model.predictor.predict(pushers, tensors, contexts.index)
    else:
        found = predict_in_pieces(model, pushers, tensors, contexts.index)
    record_timing("inference", time.perf_counter() - began)
    angles = found.mean[:, 2]
    if not _all_inside(angles):
        mean = found.mean.copy()
        mean[:, 2] = np.clip(wrap_angles(angles.astype(np.float64)), -_LARGEST_ANGLE, _LARGEST_ANGLE)
        found = found._replace(mean=mean)
    return found


def _all_inside(angles: FloatArray) -> bool:
    if len(angles) > _FEW:
        return bool(angles.max() <= _LARGEST_ANGLE and angles.min() >= -_LARGEST_ANGLE)
    values = angles.tolist()
    return bool(max(values) <= _LARGEST_ANGLE and min(values) >= -_LARGEST_ANGLE)


@dataclass(frozen=True, slots=True)
class Query(ABC):
    """A query: pushes for one model. Each protocol encodes the answer in its own way."""

    model: LoadedModel
    pushers: FloatArray  # (n, 3) poses in the object frame, or (n, 4) with lengths
    contexts: ContextBatch
    angles: Angles

    def answer(self) -> Answer:
        """Predict and encode.

        Raises:
            ContextKindError, PredictionError: see ``predict``.
        """
        return self.encode(*self.predict())

    def predict(self) -> tuple[Gaussians, Warnings]:
        """Return predictions and their warnings: the part that a thread does while the event loop goes on.

        Raises:
            ContextKindError, PredictionError: see ``predict``.
        """
        found = predict(self.model, self.pushers, self.contexts)
        return found, find_warnings(self.model.manifest, self.pushers, self.angles, self.contexts, found)

    def seconds(self) -> float:
        """Return a bound of the time that the runtime takes, by the measured cost of the version, in s."""
        return self.model.cost.seconds_of(len(self.pushers), self.contexts.count)

    @abstractmethod
    def encode(self, found: Gaussians, warnings: Warnings) -> Answer:
        """Encode predictions with their warnings as an answer."""
        ...
