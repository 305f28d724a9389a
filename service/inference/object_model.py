"""A served model as the model of one object's pushes, which planning asks."""

from dataclasses import dataclass, replace

import numpy as np

from service.inference.query import ContextBatch, predict
from service.model.loaded_model import LoadedModel
from service.model.tensors import ContextKind
from service.planning.push_model import PushOutcomes
from service.pushing.poses import DoubleArray
from service.validity.contact import contacts
from service.validity.judging import unlike_known_pushes


@dataclass(frozen=True, slots=True)
class ObjectModel:
    """Model of the pushes of one object: a served model with the context of the object.

    Attributes:
        model: the served model.
        contexts: the one context, or none for a model without contexts.
    """

    model: LoadedModel
    contexts: ContextBatch

    def __call__(self, pushes: DoubleArray) -> PushOutcomes:
        """See ``PushModel``. A model of one length gets the poses alone, whatever length a push has.

        Raises:
            ContextKindError, PredictionError, DeadlineError: see ``query.predict``.
        """
        rows = pushes[:, : 4 if self.contexts.kind is ContextKind.SHAPE else 3].astype(np.float32)
        index = None if self.contexts.index is None else np.zeros(len(rows), dtype=np.int64)
        contexts = replace(self.contexts, index=index)
        found = predict(self.model, rows, contexts)
        return PushOutcomes(
            found.mean.astype(np.float64),
            found.std.astype(np.float64),
            contacts(contexts, pushes, found.mean).misses,
            unlike_known_pushes(self.model.manifest, pushes, contexts, found),
        )
