"""Queries of ``/v1``: from a valid request to a query to its model, and from the Gaussian to JSON.

Numbers in the object frame are written with the digits of float32, numbers in the world frame with those of float64.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
import orjson

from service.api.v1.object_contexts import encode_context, encode_contexts, encode_image, read_shape, read_view
from service.inference.pushes import PushFields, push_rows, reach_m
from service.inference.query import FIRST_CONTEXT, Answer, ContextBatch, Query, Warnings
from service.inference.snapshot import Snapshot
from service.model.loaded_model import LoadedModel
from service.model.tensors import ContextKind, FloatArray, Gaussians
from service.pushing.poses import DoubleArray, into_world_frame
from service.schemas.body import Body
from service.schemas.image_contexts import describe_context, describe_shape
from service.schemas.pushes import BatchRequest, Prediction, PredictRequest
from service.schemas.shapes import ShapeDetails

_JSON: Final = orjson.OPT_SERIALIZE_NUMPY
_ONE_PUSH: Final = PushFields("body.pusher", "body.pusher.length")
_Array = FloatArray | DoubleArray
Render = Callable[[_Array, _Array, DoubleArray | None], dict[str, object]]


@dataclass(frozen=True, slots=True)
class JsonQuery(Query):
    """A query whose answer is the JSON of ``/v1``, in the world frame if the request has object poses."""

    frames: DoubleArray | None  # object poses in the world, (1, 3) or (n, 3)
    render: Render
    warn: Callable[[Warnings], list[dict[str, object]]]

    def encode(self, found: Gaussians, warnings: Warnings) -> Answer:
        """See ``Query.encode``."""
        name, version = self.model.manifest.name, self.model.manifest.version
        mean, std = found.mean, found.std
        if self.frames is None:
            frame, rows = "object", self.render(mean, std, None)
        else:
            turned, covariance = into_world_frame(mean.astype(np.float64), std.astype(np.float64), self.frames)
            spread = np.ascontiguousarray(np.sqrt(np.diagonal(covariance, axis1=1, axis2=2)))
            frame, rows = "world", self.render(turned, spread, covariance)
        listed = self.warn(warnings) if warnings else ()
        document = {"model": {"name": name, "version": version}, "frame": frame, **rows, "warnings": listed}
        return Answer(orjson.dumps(document, option=_JSON), name, version, len(mean))


def ask_single(models: Snapshot, request: PredictRequest) -> JsonQuery:
    """Return the query of a single push.

    Raises:
        RequestError: the push, the context or the reference to the model is not valid.
        ModelNotReadyError: see ``Snapshot.find``.
    """
    contexts = encode_context(request.context)
    return _single(_find(models, request, contexts), request, contexts)


def ask_model(find: Callable[[ContextKind], LoadedModel], request: PredictRequest) -> JsonQuery:
    """Return the query of a single push to the model that is found for its kind of context, whatever it names itself.

    Raises:
        RequestError: the push or the context is not valid.
    """
    contexts = encode_context(request.context)
    return _single(find(contexts.kind), request, contexts)


def ask_batch(models: Snapshot, request: BatchRequest) -> JsonQuery:
    """Return the query of many pushes. The answer of a push depends on its own row and context only.

    Raises:
        RequestError: a push, a context or the reference to the model is not valid.
        ModelNotReadyError: see ``Snapshot.find``.
    """
    contexts = encode_contexts(request.contexts, request.context_indices())
    return _batch(_find(models, request, contexts), request, contexts)


@dataclass(frozen=True, slots=True)
class ImageRequest:
    """Request for one push or many of the object in an image file."""

    pushes: PredictRequest | BatchRequest
    image: bytes
    details: ShapeDetails


def ask_image(models: Snapshot, request: ImageRequest) -> JsonQuery:
    """Return the query of one push or many of the object in an image. Blocking: it decodes.

    Raises:
        RequestError: a push, the image or the reference to the model is not valid.
        ModelNotReadyError: see ``Snapshot.find``.
    """
    pushes = request.pushes
    if isinstance(pushes, PredictRequest):
        contexts = encode_image(request.image, request.details, FIRST_CONTEXT)
        return _single(_find(models, pushes, contexts), pushes, contexts)
    contexts = encode_image(request.image, request.details, np.zeros(len(pushes.pushers), dtype=np.int64))
    return _batch(_find(models, pushes, contexts), pushes, contexts)


@dataclass(frozen=True, slots=True)
class ContextRequest:
    """Request for the context of the object in an image file."""

    image: bytes
    details: ShapeDetails


def describe_view(_models: Snapshot, request: ContextRequest) -> Answer:
    """Answer with the visual context of an image, a thumbnail and quality flags. Blocking: it decodes.

    If the scale of the image is known, answer with its shape context, and with the outline to draw over the image.

    Raises:
        ImageTooLargeError, UnsupportedImageError, InvalidImageError: see ``images.decode`` and ``find_shape``.
        InvalidRequestError: details of a shape came without the scale.
    """
    body: Body
    if request.details.metres_per_pixel is not None:
        body = describe_shape(read_shape(request.image, request.details))
    else:
        request.details.check_without_scale("body")
        body = describe_context(read_view(request.image))
    return Answer(body.model_dump_json(exclude_none=True).encode())


def _find(models: Snapshot, request: Prediction, contexts: ContextBatch) -> LoadedModel:
    reference = request.reference()
    return models.find_default(contexts.kind) if reference is None else models.find(reference)


def _single(model: LoadedModel, request: PredictRequest, contexts: ContextBatch) -> JsonQuery:
    poses = request.pusher_poses(reach_m(contexts.kind))
    rows = push_rows(model, poses, request.lengths_m(), contexts, _ONE_PUSH)
    return JsonQuery(model, rows, contexts, request.sent_angles(), request.object_frames(), _one, _of_one)


def _batch(model: LoadedModel, request: BatchRequest, contexts: ContextBatch) -> JsonQuery:
    poses, lengths_m = request.pusher_poses(reach_m(contexts.kind)), request.lengths_m()
    fields = PushFields("body.pushers.{row}", "body.lengths" if len(lengths_m) == 1 else "body.lengths.{row}")
    rows = push_rows(model, poses, lengths_m, contexts, fields)
    return JsonQuery(model, rows, contexts, request.sent_angles(), request.object_frames(), _columns, _of_rows)


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


def _of_one(warnings: Warnings) -> list[dict[str, object]]:
    return [{"code": warning.code, "detail": warning.detail} for warning in warnings]


def _of_rows(warnings: Warnings) -> list[dict[str, object]]:
    return [{"code": warning.code, "detail": warning.detail, "rows": warning.rows} for warning in warnings]
