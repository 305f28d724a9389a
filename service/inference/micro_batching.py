"""Micro-batching: all single pushes that arrive in one iteration of the event loop run in one onnxruntime call.

Under load an iteration reads many requests. onnxruntime reads the weights of a model once per call, and between two
calls the other work of a request evicts them from the cache of the core: to read them again takes longer than the rest
of a push (``benchmarks/serving.py``). No request waits for others: the call runs at the end of the iteration. The
prediction of a push is the same in every micro-batch (see ``service.model.predictor``). If a call fails, each of its
pushes is predicted alone.

Calls are bounded in time, by the cost of the version, and so are all calls of one iteration. What is left is predicted
in the next one, so that other events come in between.
"""

import asyncio
import itertools
import logging
import math
import time
from collections.abc import Callable, Sequence
from contextvars import Context
from typing import Final

import numpy as np

from service.background.supervision import ENDINGS, carried
from service.inference.query import Answer, ContextBatch, Query, Warnings, predict
from service.model.tensors import FloatArray, Gaussians
from service.observability.timings import record_timing
from service.validity.judging import find_warnings_of_each

MAX_PUSHES_PER_CALL: Final = 64  # holds the event loop for a tenth of a millisecond
CALL_S: Final = 0.01  # of a call in the event loop, at most. A version that takes longer for one push needs a thread.
ITERATION_S: Final = 0.02  # of all calls of an iteration: no other begins after it
Prediction = tuple[Gaussians, Warnings, float]  # of one push, and the seconds that the call took
Outcome = Prediction | BaseException
Callback = Callable[[Outcome], None]
_Waiting = tuple[Query, Callback]

logger = logging.getLogger(__name__)


class MicroBatcher:
    """Collect the single pushes of each iteration of one event loop."""

    def __init__(self) -> None:
        self._waiting: list[_Waiting] = []
        self._failed: list[tuple[BaseException, Callback]] = []

    def submit(self, query: Query, callback: Callback) -> None:
        """Predict one push at the end of this iteration. The callback gets the prediction, or the error raised."""
        self._schedule()
        self._waiting.append((query, callback))

    def fail(self, error: BaseException, callback: Callback) -> None:
        """Pass an error to the callback at the end of this iteration, for a push that cannot be submitted."""
        self._schedule()
        self._failed.append((error, callback))

    async def answer(self, query: Query) -> Answer:
        """Answer a query of one push.

        Raises:
            ContextKindError, PredictionError: see ``Query.answer``.
        """
        future: asyncio.Future[Prediction] = asyncio.get_running_loop().create_future()

        def callback(outcome: Outcome) -> None:
            """Settle the future."""
            if future.done():  # its client has left
                return
            if isinstance(outcome, BaseException):
                future.set_exception(carried(outcome))
            else:
                future.set_result(outcome)

        self.submit(query, callback)
        found, warnings, seconds = await future
        record_timing("inference", seconds)
        return query.encode(found, warnings)

    def flush(self) -> None:
        """Predict the waiting pushes now."""
        self._predict(math.inf)

    def _end_iteration(self) -> None:
        """Predict the waiting pushes, or as many as one iteration may."""
        self._predict(time.perf_counter() + ITERATION_S)

    def _predict(self, latest: float) -> None:
        waiting, self._waiting = self._waiting, []
        failed, self._failed = self._failed, []
        for error, callback in failed:
            _call(callback, error)
        groups = _groups(waiting)
        for number, group in enumerate(groups):
            if number and time.perf_counter() > latest:
                self._schedule()
                self._waiting = [*itertools.chain.from_iterable(groups[number:]), *self._waiting]
                return
            _settle(group)

    def _schedule(self) -> None:
        if not self._waiting and not self._failed:  # in an empty context: each request records its own timing
            asyncio.get_running_loop().call_soon(self._end_iteration, context=Context())


def _groups(waiting: list[_Waiting]) -> list[list[_Waiting]]:
    """Group queries of one model with one kind of context, at most ``MAX_PUSHES_PER_CALL`` and ``CALL_S`` together."""
    if len(waiting) == 1:
        return [waiting]
    filling: dict[tuple[int, str], tuple[list[_Waiting], int]] = {}
    groups: list[list[_Waiting]] = []
    for one in waiting:
        model = one[0].model
        key = (id(model), one[0].contexts.kind)
        group, most = filling.get(key) or ([], 0)
        if len(group) == most:
            group, most = [], min(MAX_PUSHES_PER_CALL, model.cost.contexts_within(CALL_S))
            filling[key] = group, most
            groups.append(group)
        group.append(one)
    return groups


def _settle(group: Sequence[_Waiting]) -> None:
    """Predict a group and call every callback, also after an error."""
    try:
        found = _predict([query for query, _ in group])
    except ENDINGS:
        raise
    except BaseException as error:  # one push must not fail the others, and a bug here must not leave them waiting
        if len(group) > 1:
            for one in group:
                _settle([one])
        else:
            _call(group[0][1], error)
        return
    for (_, callback), prediction in zip(group, found, strict=True):
        _call(callback, prediction)


def _call(callback: Callback, outcome: Outcome) -> None:
    try:
        callback(outcome)
    except ENDINGS:
        raise
    except BaseException:  # as above
        logger.exception("an answer was lost")


def _predict(queries: Sequence[Query]) -> list[Prediction]:
    model = queries[0].model
    pushers, contexts = _together(queries)
    began = time.perf_counter()
    found = predict(model, pushers, contexts)
    seconds = time.perf_counter() - began
    angles, own = [query.angles for query in queries], [query.contexts for query in queries]
    warnings = find_warnings_of_each(model.manifest, pushers, angles, own, found)
    return list(zip(found.each() if len(queries) > 1 else [found], warnings, itertools.repeat(seconds)))


def _together(queries: Sequence[Query]) -> tuple[FloatArray, ContextBatch]:
    """Return the pushes of all queries, and their distinct contexts."""
    first = queries[0].contexts
    if len(queries) == 1:
        return queries[0].pushers, first
    pushers = np.concatenate([query.pushers for query in queries])
    if not first.tensors:
        return pushers, first
    distinct = {id(query.contexts.tensors[0]): query.contexts.tensors for query in queries}  # cached ones are the same
    order = {key: number for number, key in enumerate(distinct)}
    tensors = tuple(map(np.concatenate, zip(*distinct.values(), strict=True)))
    index = np.array([order[id(query.contexts.tensors[0])] for query in queries], dtype=np.int64)
    return pushers, ContextBatch(first.kind, tensors, index, first.where)
