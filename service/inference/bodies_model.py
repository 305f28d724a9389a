"""A served model of any shape as the model of many bodies with one outline, which refinement asks."""

from dataclasses import dataclass

import numpy as np

from service.inference.query import ContextBatch, predict
from service.model.loaded_model import LoadedModel
from service.model.tensors import ContextKind
from service.pushing.poses import DoubleArray
from service.pushing.shape_context import ShapeTensors


@dataclass(frozen=True, slots=True)
class BodiesModel:
    """Model of the pushes of many bodies: a served model of any shape. See ``planning.refine.BodiesModel``.

    Attributes:
        model: the served model.
        where: field of the request that has the context, for errors.
    """

    model: LoadedModel
    where: str

    def __call__(self, bodies: ShapeTensors, pushes: DoubleArray) -> tuple[DoubleArray, DoubleArray]:
        """Return mean and std (n, k, 3) of each push (k, 4) of each body (n) in the object frame.

        Raises:
            ContextKindError, PredictionError, DeadlineError: see ``query.predict``.
        """
        count, each = len(bodies.body), len(pushes)
        index = np.repeat(np.arange(count), each)
        rows = np.tile(pushes.astype(np.float32), (count, 1))
        found = predict(self.model, rows, ContextBatch(ContextKind.SHAPE, tuple(bodies), index, self.where))
        shape = (count, each, 3)
        return found.mean.astype(np.float64).reshape(shape), found.std.astype(np.float64).reshape(shape)
