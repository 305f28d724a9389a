"""The object that a question is about: its context, its outline, and the served model of its pushes."""

from dataclasses import dataclass
from typing import Final

from service.api.v1.object_contexts import encode_context, encode_known
from service.errors import InvalidRequestError
from service.inference.object_model import ObjectModel
from service.inference.query import ContextBatch
from service.inference.snapshot import Snapshot
from service.pushing.contexts import SupportContext, VisualContext
from service.pushing.outlines import Outline
from service.pushing.poses import PUSH_LENGTH_M
from service.pushing.shape_context import PUSHER_RADIUS_M, ShapeContext
from service.pushing.sides import outline
from service.schemas.contexts import ContextBody
from service.schemas.pushes import Prediction

_SAME_M: Final = 1e-6


@dataclass(frozen=True, slots=True)
class OutlinedObject:
    """Object of known outline.

    Attributes:
        model: of its pushes.
        outline: in the object frame.
        pusher_radius_m: radius of the tip.
    """

    model: ObjectModel
    outline: Outline
    pusher_radius_m: float


def find_object(models: Snapshot, request: Prediction, context: ContextBody | None) -> ObjectModel:
    """Return the model of an object's pushes. Blocking: it encodes the context.

    Raises:
        RequestError: the context or the reference to the model is not valid.
        ModelNotReadyError: see ``Snapshot.find``.
    """
    return _find(models, request, encode_context(context))


def find_outlined_object(models: Snapshot, request: Prediction, context: ContextBody) -> OutlinedObject:
    """Return an object of known outline, and the model of its pushes. Blocking: it encodes the context.

    Raises:
        RequestError: the context has no outline, or see ``find_object``.
        ModelNotReadyError: see ``Snapshot.find``.
    """
    known, flags = context.describe()
    if isinstance(known, VisualContext | SupportContext):
        received = "a view without its scale" if isinstance(known, VisualContext) else "a support, which has no outline"
        accepted = "an outline, an image with metres_per_pixel, or a descriptor"
        raise InvalidRequestError.at("body.context", received, accepted)
    model = _find(models, request, encode_known(known, flags))
    if isinstance(known, ShapeContext):
        return OutlinedObject(model, known.outline, known.pusher_radius_m or PUSHER_RADIUS_M)
    return OutlinedObject(model, outline(known), PUSHER_RADIUS_M)


def check_length(asked: ObjectModel, length_m: float, where: str) -> None:
    """Refuse a length that the model of an object does not know.

    Raises:
        InvalidRequestError: the model knows one length only, and this is another.
    """
    if not asked.knows_lengths and abs(length_m - PUSH_LENGTH_M) > _SAME_M:
        name = asked.model.manifest.name
        accepted = f"{PUSH_LENGTH_M:g} m, the only length that {name} knows; send the object's outline as context"
        raise InvalidRequestError.at(where, f"{length_m:.6g} m", accepted)


def _find(models: Snapshot, request: Prediction, contexts: ContextBatch) -> ObjectModel:
    reference = request.reference()
    model = models.find_default(contexts.kind) if reference is None else models.find(reference)
    return ObjectModel(model, contexts)
