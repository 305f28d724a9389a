"""The object that a question is about: its context, and the served model of its pushes."""

from service.api.v1.object_contexts import encode_context
from service.errors import InvalidRequestError
from service.inference.object_model import ObjectModel
from service.inference.snapshot import Snapshot
from service.pushing.poses import PUSH_LENGTH_M
from service.schemas.contexts import ContextBody
from service.schemas.pushes import Prediction

_SAME_M = 1e-6


def find_object(models: Snapshot, request: Prediction, context: ContextBody | None) -> ObjectModel:
    """Return the model of an object's pushes. Blocking: it encodes the context.

    Raises:
        RequestError: the context or the reference to the model is not valid.
        ModelNotReadyError: see ``Snapshot.find``.
    """
    contexts = encode_context(context)
    reference = request.reference()
    model = models.find_default(contexts.kind) if reference is None else models.find(reference)
    return ObjectModel(model, contexts)


def check_length(asked: ObjectModel, length_m: float, where: str) -> None:
    """Refuse a length that the model of an object does not know.

    Raises:
        InvalidRequestError: the model knows one length only, and this is another.
    """
    if not asked.knows_lengths and abs(length_m - PUSH_LENGTH_M) > _SAME_M:
        name = asked.model.manifest.name
        accepted = f"{PUSH_LENGTH_M:g} m, the only length that {name} knows; send the object's outline as context"
        raise InvalidRequestError.at(where, f"{length_m:.6g} m", accepted)
