"""Queries of ``/v1``: from a valid request to a query to its model, and from the Gaussian to JSON.

Numbers in the object frame are written with the digits of float32, numbers in the world frame with those of float64.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
import orjson

from service.api.v1.object_contexts import encode_context, encode_contexts, encode_image, read_view
from service.inference.query import FIRST_CONTEXT, Answer, ContextBatch, Query
from service.inference.snapshot import Snapshot
from service.model.loaded_model import LoadedModel
from service.model.tensors import FloatArray, Gaussians
from service.pushing.poses import DoubleArray, into_world_frame
from service.schemas.contexts import describe_context
from service.schemas.pushes import BatchRequest, Prediction, PredictRequest

_JSON: Final = orjson.OPT_SERIALIZE_NUMPY
_Array = FloatArray | DoubleArray
Render = Callable[[_Array, _Array, DoubleArray | None], dict[str, object]]


@dataclass(frozen=True, slots=True)
class JsonQuery(Query):
    """A query whose answer is the JSON of ``/v1``, in the world frame if the request has object poses."""

    frames: DoubleArray | None  # object poses in the world, (1, 3) or (n, 3)
    render: Render

    def encode(self, found: Gaussians) -> Answer:
        """See ``Query.encode``."""
        name, version = self.model.manifest.name, self.model.manifest.version
        document: dict[str, object] = {"model": {"name": name, "version": version}}
        mean, std = found.mean, found.std
        if self.frames is None:
            document |= {"frame": "object", **self.render(mean, std, None)}
        else:
            turned, covariance = into_world_frame(mean.astype(np.float64), std.astype(np.float64), self.frames)
            spread = np.ascontiguousarray(np.sqrt(np.diagonal(covariance, axis1=1, axis2=2)))
            document |= {"frame": "world", **self.render(turned, spread, covariance)}
        return Answer(orjson.dumps(document, option=_JSON), name, version, len(mean))


def ask_single(models: Snapshot, request: PredictRequest) -> JsonQuery:
    """Return the query of a single push.

    Raises:
        RequestError: the push, the context or the reference to the model is not valid.
        ModelNotReadyError: see ``Snapshot.find``.
    """
    contexts = encode_context(request.context)
    return _single(_find(models, request, contexts), request, contexts)


def ask_model(model: LoadedModel, request: PredictRequest) -> JsonQuery:
    """Return the query of a single push to this model, even if the request names another.

    Raises:
        RequestError: the push or the context is not valid.
    """
    return _single(model, request, encode_context(request.context))


def ask_batch(models: Snapshot, request: BatchRequest) -> JsonQuery:
    """Return the query of many pushes. The answer of a push depends on its own row and context only.

    Raises:
        RequestError: a push, a context or the reference to the model is not valid.
        ModelNotReadyError: see ``Snapshot.find``.
    """
    pushers = request.pusher_poses()
    contexts = encode_contexts(request.contexts, request.context_indices())
    return _batch(_find(models, request, contexts), pushers, request, contexts)


@dataclass(frozen=True, slots=True)
class ImageRequest:
    """Request for one push or many of the object in an image file."""

    pushes: PredictRequest | BatchRequest
    image: bytes


def ask_image(models: Snapshot, request: ImageRequest) -> JsonQuery:
    """Return the query of one push or many of the object in an image. Blocking: it decodes.

    Raises:
        RequestError: a push, the image or the reference to the model is not valid.
        ModelNotReadyError: see ``Snapshot.find``.
    """
    pushes = request.pushes
    if isinstance(pushes, PredictRequest):
        contexts = encode_image(request.image, FIRST_CONTEXT)
        return _single(_find(models, pushes, contexts), pushes, contexts)
    contexts = encode_image(request.image, np.zeros(len(pushes.pushers), dtype=np.int64))
    return _batch(_find(models, pushes, contexts), pushes.pusher_poses(), pushes, contexts)


def describe_view(_models: Snapshot, image: bytes) -> Answer:
    """Answer with the visual context of an image, a thumbnail and quality flags. Blocking: it decodes.

    Raises:
        ImageTooLargeError, UnsupportedImageError, InvalidImageError: see ``images.decode``.
    """
    return Answer(describe_context(read_view(image)).model_dump_json().encode())


def _find(models: Snapshot, request: Prediction, contexts: ContextBatch) -> LoadedModel:
    reference = request.reference()
    return models.find_default(contexts.kind) if reference is None else models.find(reference)


def _single(model: LoadedModel, request: PredictRequest, contexts: ContextBatch) -> JsonQuery:
    return JsonQuery(model, request.pusher_poses().astype(np.float32), contexts, request.object_frames(), _one)


def _batch(model: LoadedModel, pushers: DoubleArray, request: BatchRequest, contexts: ContextBatch) -> JsonQuery:
    return JsonQuery(model, pushers.astype(np.float32), contexts, request.object_frames(), _columns)


def _one(mean: _Array, std: _Array, covariance: DoubleArray | None) -> dict[str, object]:
    (x, y, angle), (x_std, y_std, angle_std) = mean[0], std[0]
    rows: dict[str, object] = {
        "mean": {"x": x, "y": y, "angle": angle},
        "std": {"x": x_std, "y": y_std, "angle": angle_std},
    }
    return rows if covariance is None else {**rows, "covariance": covariance[0]}


def _columns(mean: _Array, std: _Array, covariance: DoubleArray | None) -> dict[str, object]:
    rows: dict[str, object] = {"mean": mean, "std": std}
    return rows if covariance is None else {**rows, "covariance": covariance}
