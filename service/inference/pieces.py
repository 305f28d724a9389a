"""Pieces of a query: calls of the runtime that are bounded in memory and in time, however many pushes a query has.

A piece has some contexts and their pushes, so each context is encoded once, except where its pushes fill more than one
piece. A context without a push is not encoded. The prediction of a push depends on that push and its context alone, to
the bit, so predictions are the same in any pieces. A thread pauses between two pieces (see ``service.turns``).
"""

from collections.abc import Iterator

import numpy as np

from service.model.loaded_model import LoadedModel
from service.model.push_cost import PieceLimits
from service.model.tensors import FloatArray, IndexArray
from service.turns import pause


def predict_in_pieces(
    model: LoadedModel, pushers: FloatArray, tensor: FloatArray | None, index: IndexArray | None
) -> tuple[FloatArray, FloatArray]:
    """Return mean and std (n, 3) of pushes (n, 3) with the contexts ``tensor[index]``.

    Raises:
        PredictionError: the runtime failed.
        DeadlineError: see ``service.turns.pause``.
    """
    limits = PieceLimits.of(model.predictor.size, model.cost)
    if len(pushers) <= limits.pushes and (tensor is None or len(tensor) <= limits.contexts):
        return model.predictor.predict(pushers, tensor, index)
    mean, std = np.empty_like(pushers), np.empty_like(pushers)
    if tensor is None or index is None:
        for begin in range(0, len(pushers), limits.pushes):
            piece = slice(begin, begin + limits.pushes)
            mean[piece], std[piece] = model.predictor.predict(pushers[piece], None, None)
            pause()
        return mean, std
    used, place = np.unique(index, return_inverse=True)
    order = np.argsort(place, kind="stable")
    for piece, first, last in _pieces(place[order], limits):
        rows = order[piece]
        mean[rows], std[rows] = model.predictor.predict(
            pushers[rows], tensor[used[first : last + 1]], place[rows] - first
        )
        pause()
    return mean, std


def _pieces(index: IndexArray, limits: PieceLimits) -> Iterator[tuple[slice, int, int]]:
    """Cut an ascending index (n,) without gaps. Yield the positions of each piece, and its first and last context."""
    begin = 0
    while begin < len(index):
        first = int(index[begin])
        end = min(begin + limits.pushes, int(np.searchsorted(index, first + limits.contexts)))
        yield slice(begin, end), first, int(index[end - 1])
        begin = end
