"""Single pushes that arrive in one turn of the event loop are asked about in one call of the runtime.

Under load a turn finds many requests. The runtime reads a model's weights once a call, and between two calls the rest
of a request has driven them out of the core's cache: reading them took longer than all else that a push needs. Nobody
waits for others to come: what is there is asked at the end of the turn. A push's answer is the same to the bit with
whatever stands beside it (``predictor`` sees to that), and where a call fails, each of its pushes is asked about alone.
"""

import asyncio
import time
from collections.abc import Iterable, Sequence
from contextvars import Context
from typing import Final

import numpy as np

from service.contract import FloatArray
from service.predictions import Answer, Question
from service.stopwatch import took

MOST_PUSHES: Final = 64  # of one call, which holds the loop for as long: a tenth of a millisecond
Gaussian = tuple[FloatArray, FloatArray, float]  # mean and std (1, 3), and the seconds that the call took
Waiting = tuple[Question, "asyncio.Future[Gaussian]"]


class Turns:
    """Gathers the single pushes of a turn; for one event loop."""

    def __init__(self) -> None:
        self._waiting: list[Waiting] = []

    async def answer(self, question: Question) -> Answer:
        """The answer to a question of one push.

        Raises:
            ContextKindError, PredictionError: as ``Question.answer``.
        """
        loop = asyncio.get_running_loop()
        future: asyncio.Future[Gaussian] = loop.create_future()
        if not self._waiting:
            loop.call_soon(self._ask, context=Context())  # of no request: each tells its own time below
        self._waiting.append((question, future))
        mean, std, seconds = await future
        took("inference", seconds)
        return question.answered(mean, std)

    def _ask(self) -> None:
        waiting, self._waiting = self._waiting, []
        for group in _groups(waiting):
            _settle(group)


def _groups(waiting: Iterable[Waiting]) -> list[list[Waiting]]:
    """Those for one model with one kind of object together, so many at once."""
    filling: dict[tuple[int, str], list[Waiting]] = {}
    groups: list[list[Waiting]] = []
    for one in waiting:
        key = (id(one[0].model), one[0].objects.kind)
        group = filling.get(key)
        if group is None or len(group) == MOST_PUSHES:
            group = filling[key] = []
            groups.append(group)
        group.append(one)
    return groups


def _settle(group: Sequence[Waiting]) -> None:
    """Ask about a group, and tell everybody who still waits; whatever happens, nobody is left waiting."""
    try:
        found = _predict([question for question, _ in group])
    except Exception as error:  # one push must not spoil the others, and a bug here must not leave them waiting
        if len(group) > 1:
            for one in group:
                _settle([one])
        elif not group[0][1].done():
            group[0][1].set_exception(error)
        return
    for (_, future), gaussian in zip(group, found, strict=True):
        if not future.done():  # or its client has left
            future.set_result(gaussian)


def _predict(questions: Sequence[Question]) -> list[Gaussian]:
    began = time.perf_counter()
    objects = questions[0].objects
    pushers, tensor, places = questions[0].pushers, objects.tensor, objects.places
    if len(questions) > 1:
        pushers = np.concatenate([question.pushers for question in questions])
        if tensor is not None:
            distinct = {id(question.objects.tensor): question.objects.tensor for question in questions}
            order = {key: place for place, key in enumerate(distinct)}
            tensor = np.concatenate([known for known in distinct.values() if known is not None])
            places = np.array([order[id(question.objects.tensor)] for question in questions], dtype=np.int64)
    mean, std = questions[0].model.predict(pushers, objects.kind, tensor, places)
    seconds = time.perf_counter() - began
    return [(mean[row : row + 1], std[row : row + 1], seconds) for row in range(len(questions))]
