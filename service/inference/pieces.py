"""Pieces of a query: calls of the runtime that are bounded in memory and in time, however many pushes a query has.

A piece has some contexts and their pushes, so each context is encoded once, except where its pushes fill more than one
piece. A context without a push is not encoded. The prediction of a push depends on that push and its context alone, to
the bit, so predictions are the same in any pieces. A thread pauses between two pieces (see ``service.turns``).
"""

from collections.abc import Iterable, Iterator

import numpy as np

from service.model.loaded_model import LoadedModel
from service.model.push_cost import PieceLimits
from service.model.tensors import FloatArray, Gaussians, IndexArray
from service.turns import pause


def predict_in_pieces(
    model: LoadedModel, pushers: FloatArray, tensors: tuple[FloatArray, ...], index: IndexArray | None
) -> Gaussians:
    """Return the predictions of pushes (n, 3 or 4) with the contexts ``tensor[index]``.

    Raises:
        PredictionError: the runtime failed.
        DeadlineError: see ``service.turns.pause``.
    """
    limits = PieceLimits.of(model.predictor.size, model.cost)
    if len(pushers) <= limits.pushes and (not tensors or len(tensors[0]) <= limits.contexts):
        return model.predictor.predict(pushers, tensors, index)
    parts: list[Gaussians] = []
    if not tensors or index is None:
        for begin in range(0, len(pushers), limits.pushes):
            parts.append(model.predictor.predict(pushers[begin : begin + limits.pushes], (), None))
            pause()
        return _joined(parts, None)
    used, place = np.unique(index, return_inverse=True)
    order = np.argsort(place, kind="stable")
    for piece, first, last in _pieces(place[order], limits):
        rows, contexts = order[piece], used[first : last + 1]
        part = tuple(tensor[contexts] for tensor in tensors)
        parts.append(model.predictor.predict(pushers[rows], part, place[rows] - first))
        pause()
    return _joined(parts, order)


def _joined(parts: list[Gaussians], order: IndexArray | None) -> Gaussians:
    """Join pieces. ``order`` (n,) has the row of each of their rows, one after the other."""

    def whole(pieces: Iterable[FloatArray]) -> FloatArray:
        """Return one array of a prediction."""
        joined = np.concatenate(list(pieces))
        if order is None:
            return joined
        placed = np.empty_like(joined)
        placed[order] = joined
        return placed

    known = [part.unfamiliarity for part in parts if part.unfamiliarity is not None]
    mean, std = whole(part.mean for part in parts), whole(part.std for part in parts)
    return Gaussians(mean, std, whole(known) if known else None)


def _pieces(index: IndexArray, limits: PieceLimits) -> Iterator[tuple[slice, int, int]]:
    """Cut an ascending index (n,) without gaps. Yield the positions of each piece, and its first and last context."""
    begin = 0
    while begin < len(index):
        first = int(index[begin])
        end = min(begin + limits.pushes, int(np.searchsorted(index, first + limits.contexts)))
        yield slice(begin, end), first, int(index[end - 1])
        begin = end
