"""From a request that is valid in itself to the bytes of its answer: which model, which objects, which frame.

Every way in comes through here, the fast one and the documented one, so that both give the same bytes. Numbers of the
object frame are written as float32 needs them and no longer; those of the world frame as float64.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
import orjson

from service.api.v1.object_contexts import _object, _objects, _seen
from service.api.v1.uploads import Upload
from service.inference.query import FIRST_OBJECT, NO_OBJECT, Answer, Asked, Objects
from service.inference.snapshot import Snapshot
from service.model.loaded_model import LoadedModel
from service.model.tensors import ContextKind, FloatArray
from service.pushing.poses import DoubleArray, into_world_frame
from service.schemas.contexts import describe_image
from service.schemas.pushes import BatchRequest, Prediction, PredictRequest

LIGHT_PUSHES: Final = 256  # as many are answered in about the time that handing them to a thread takes
LIGHT_OBJECTS: Final = 256  # so many are encoded in the event loop
_JSON: Final = orjson.OPT_SERIALIZE_NUMPY
Render = Callable[[FloatArray | DoubleArray, FloatArray | DoubleArray, DoubleArray | None], dict[str, object]]


@dataclass(frozen=True, slots=True)
class Question(Asked):
    """Asked in JSON of ours, with the objects in the world where that was said."""

    frames: DoubleArray | None  # where the objects are, (1, 3) or (n, 3)
    render: Render

    def answered(self, mean: FloatArray, std: FloatArray) -> Answer:
        """See ``Asked.answered``."""
        name, version = self.model.manifest.name, self.model.manifest.version
        document: dict[str, object] = {"model": {"name": name, "version": version}}
        if self.frames is None:
            document |= {"frame": "object", **self.render(mean, std, None)}
        else:
            turned, covariance = into_world_frame(mean.astype(np.float64), std.astype(np.float64), self.frames)
            spread = np.ascontiguousarray(np.sqrt(np.diagonal(covariance, axis1=1, axis2=2)))
            document |= {"frame": "world", **self.render(turned, spread, covariance)}
        return Answer(orjson.dumps(document, option=_JSON), self.notes())


def ask_one(models: Snapshot, request: PredictRequest) -> Question:
    """What a request for one push asks.

    Raises:
        RequestError: the push, the object or the model asked for cannot be.
        ModelNotReadyError: as ``Snapshot.find``.
    """
    objects = _object(request)
    return _one_push(_model(models, request, objects.kind), request, objects)


def predict_one(models: Snapshot, request: PredictRequest) -> Answer:
    """Answer one push.

    Raises:
        RequestError, ModelNotReadyError: as ``ask_one``.
        PredictionError: as ``LoadedModel.predict``.
    """
    return ask_one(models, request).answer()


def predict_with(model: LoadedModel, request: PredictRequest) -> Answer:
    """Answer one push by this model, whichever the request asks for.

    Raises:
        RequestError, PredictionError: as ``predict_one``.
    """
    return _one_push(model, request, _object(request)).answer()


def ask_batch(models: Snapshot, request: BatchRequest) -> Question:
    """What a request for many pushes asks.

    Raises:
        RequestError: a push, an object or the model asked for cannot be.
        ModelNotReadyError: as ``Snapshot.find``.
    """
    pushers, places = request.pusher_poses(), None
    if request.contexts is not None or request.context_index is not None:
        places = request.places()
    objects = NO_OBJECT if places is None else _objects(request.contexts or (), places)
    model = _model(models, request, objects.kind)
    return Question(model, pushers.astype(np.float32), objects, request.objects(), _columns)


def predict_batch(models: Snapshot, request: BatchRequest) -> Answer:
    """Answer many pushes; a push's answer depends on its own row and object only.

    Raises:
        RequestError, ModelNotReadyError: as ``ask_batch``.
        PredictionError: as ``LoadedModel.predict``.
    """
    return ask_batch(models, request).answer()


def predict_upload(models: Snapshot, upload: Upload) -> Answer:
    """Answer one push (field ``pusher``) or many (``pushers``) of the object in an image; blocking: it decodes.

    The fields are looked at first: they cost less than the image.

    Raises:
        ValidationError: a field is not what the schemas say.
        RequestError, ModelNotReadyError, PredictionError: as ``predict_one`` and ``images.decode``.
    """
    if "pushers" not in upload.fields:
        request = PredictRequest.model_validate(upload.fields)
        objects = _seen(upload.image, FIRST_OBJECT)
        return _one_push(_model(models, request, objects.kind), request, objects).answer()
    batch = BatchRequest.model_validate(upload.fields)
    objects = _seen(upload.image, np.zeros(len(batch.pushers), dtype=np.int64))
    model, pushers = _model(models, batch, objects.kind), batch.pusher_poses().astype(np.float32)
    return Question(model, pushers, objects, batch.objects(), _columns).answer()


def describe_upload(_models: Snapshot, upload: Upload) -> Answer:
    """Say what a model sees of an image; blocking: it decodes.

    Raises:
        RequestError: as ``images.decode``.
    """
    return Answer(describe_image(upload.image).model_dump_json().encode(), {})


def is_light(request: PredictRequest | BatchRequest) -> bool:
    """Whether a request of few bytes may be answered in the event loop."""
    return is_read_quickly(request) and (not isinstance(request, BatchRequest) or len(request.pushers) <= LIGHT_PUSHES)


def is_read_quickly(request: object) -> bool:
    """Whether the event loop may work out what a request of few bytes asks: it has few objects, and no pictures."""
    if isinstance(request, BatchRequest):
        contexts = request.contexts or ()
        return len(contexts) <= LIGHT_OBJECTS and all(context.image is None for context in contexts)
    return not isinstance(request, PredictRequest) or request.context is None or request.context.image is None


def _one_push(model: LoadedModel, request: PredictRequest, objects: Objects) -> Question:
    return Question(model, request.pusher_poses().astype(np.float32), objects, request.objects(), _one)


def _model(models: Snapshot, request: Prediction, kind: ContextKind) -> LoadedModel:
    reference = request.reference()
    return models.find_default(kind) if reference is None else models.find(reference)


def _one(
    mean: FloatArray | DoubleArray, std: FloatArray | DoubleArray, covariance: DoubleArray | None
) -> dict[str, object]:
    (x, y, angle), (x_std, y_std, angle_std) = mean[0], std[0]
    rows: dict[str, object] = {
        "mean": {"x": x, "y": y, "angle": angle},
        "std": {"x": x_std, "y": y_std, "angle": angle_std},
    }
    return rows if covariance is None else {**rows, "covariance": covariance[0]}


def _columns(
    mean: FloatArray | DoubleArray, std: FloatArray | DoubleArray, covariance: DoubleArray | None
) -> dict[str, object]:
    rows: dict[str, object] = {"mean": mean, "std": std}
    return rows if covariance is None else {**rows, "covariance": covariance}
