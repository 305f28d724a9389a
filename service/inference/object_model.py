"""A served model as the model of one object's pushes, which planning asks."""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from service.inference.pushes import starts_inside
from service.inference.query import ContextBatch, Warnings, predict
from service.model.loaded_model import LoadedModel
from service.model.tensors import ContextKind
from service.planning.push_model import PushOutcomes
from service.pushing.poses import PUSH_LENGTH_M, DoubleArray
from service.pushing.shape_context import BODY, ShapeTensors
from service.validity.codes import Angles, WarningCode
from service.validity.contact import contacts
from service.validity.judging import find_warnings, unlike_known_pushes

_OF_PUSHES: Final = frozenset((WarningCode.NO_CONTACT, WarningCode.STARTS_INSIDE, WarningCode.UNFAMILIAR_PUSH))
_CENTRE_OF_MASS: Final = slice(BODY.index("centre_of_mass_x"), BODY.index("centre_of_mass_x") + 2)
_ANY_PUSH: Final = np.array([[-0.1, 0.0, 0.0, PUSH_LENGTH_M]])


@dataclass(frozen=True, slots=True)
class ObjectModel:
    """Model of the pushes of one object: a served model with the context of the object.

    Attributes:
        model: the served model.
        contexts: the one context, or none for a model without contexts.
    """

    model: LoadedModel
    contexts: ContextBatch

    @property
    def knows_lengths(self) -> bool:
        """Return whether the model knows other lengths of pushes than ``PUSH_LENGTH_M``."""
        return self.contexts.kind is ContextKind.SHAPE

    def __call__(self, pushes: DoubleArray) -> PushOutcomes:
        """See ``PushModel``. A model of one length gets the poses alone, whatever length a push has.

        Raises:
            ContextKindError, PredictionError, DeadlineError: see ``query.predict``.
        """
        contexts, centre_m = self._contexts_of(len(pushes)), np.zeros(2)
        if contexts.kind is ContextKind.SHAPE:
            contexts, centre_m = _centred(contexts)
            pushes = pushes - [*centre_m, 0.0, 0.0]
        found = predict(self.model, self._rows(pushes), contexts)
        met = contacts(contexts, pushes, found.mean)
        inside = met.inside
        if contexts.kind is ContextKind.SHAPE and contexts.index is not None:
            inside = starts_inside(ShapeTensors(*contexts.tensors).outline, contexts.index, pushes[:, :3])
        unfamiliar = unlike_known_pushes(self.model.manifest, pushes, contexts, found)
        mean = found.mean.astype(np.float64)
        cos, sin = np.cos(mean[:, 2]), np.sin(mean[:, 2])
        x, y = centre_m
        mean[:, :2] += np.stack([x - (cos * x - sin * y), y - (sin * x + cos * y)], axis=1)
        return PushOutcomes(mean, found.std.astype(np.float64), met.misses & ~inside, inside, unfamiliar, centre_m)

    def object_warnings(self, angles: Angles) -> Warnings:
        """Return the warnings about the object, its picture and the angles of a request, whatever its pushes are.

        Raises:
            ContextKindError, PredictionError, DeadlineError: see ``query.predict``.
        """
        contexts, rows = self._contexts_of(1), self._rows(_ANY_PUSH)
        found = predict(self.model, rows, contexts)
        warnings = find_warnings(self.model.manifest, rows, angles, contexts, found)
        return tuple(warning for warning in warnings if warning.code not in _OF_PUSHES)

    def _rows(self, pushes: DoubleArray) -> np.ndarray:
        return pushes[:, : 4 if self.knows_lengths else 3].astype(np.float32)

    def _contexts_of(self, count: int) -> ContextBatch:
        """Return the context of this many pushes."""
        if self.contexts.index is None:
            return self.contexts
        return replace(self.contexts, index=np.zeros(count, dtype=np.int64))


def _centred(contexts: ContextBatch) -> tuple[ContextBatch, DoubleArray]:
    """Return the context of a shape in a frame whose origin is its centroid, and that place (2,) in its own frame.

    About the centroid errors of place and yaw are independent.
    """
    shape = ShapeTensors(*contexts.tensors)
    centre = shape.body[:, :2].copy()
    support, body = shape.support.copy(), shape.body.copy()
    support[..., :2] -= np.where(support[..., 2:] > 0.0, centre[:, None], 0.0)  # free rows hold 0
    body[:, :2] -= centre
    body[:, _CENTRE_OF_MASS] -= centre
    moved = ShapeTensors(shape.silhouette, shape.outline - centre[:, None], support, body)
    return replace(contexts, tensors=tuple(moved)), centre[0].astype(np.float64)
