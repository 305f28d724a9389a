"""Single pushes that arrive in one turn of the event loop are asked about in one call of the runtime.

Under load a turn finds many requests. The runtime reads a model's weights once a call, and between two calls the rest
of a request has driven them out of the core's cache: reading them took longer than all else that a push needs. Nobody
waits for others to come: what is there is asked at the end of the turn. A push's answer is the same to the bit with
whatever stands beside it (``predictor`` sees to that), and where a call fails, each of its pushes is asked about alone.
"""

import asyncio
import logging
import time
from collections.abc import Callable, Iterable, Sequence
from contextvars import Context
from typing import Final

import numpy as np

from service.api.v1.queries import Question
from service.inference.query import Answer
from service.model.tensors import FloatArray
from service.observability.timings import took

MOST_PUSHES: Final = 64  # of one call, which holds the loop for as long: a tenth of a millisecond
Gaussian = tuple[FloatArray, FloatArray, float]  # mean and std (1, 3), and the seconds that the call took
Tell = Callable[[Gaussian | Exception], None]
Waiting = tuple[Question, Tell]

logger = logging.getLogger(__name__)


class Turns:
    """Gathers the single pushes of a turn; for one event loop."""

    def __init__(self) -> None:
        self._waiting: list[Waiting] = []

    def ask(self, question: Question, tell: Tell) -> None:
        """Ask about one push at the end of this turn; ``tell`` gets the outcome, an error as it was raised."""
        if not self._waiting:  # of no request: each is told its own time
            asyncio.get_running_loop().call_soon(self.end, context=Context())
        self._waiting.append((question, tell))

    async def answer(self, question: Question) -> Answer:
        """The answer to a question of one push.

        Raises:
            ContextKindError, PredictionError: as ``Question.answer``.
        """
        future: asyncio.Future[Gaussian] = asyncio.get_running_loop().create_future()

        def tell(outcome: Gaussian | Exception) -> None:
            if future.done():  # its client has left
                return
            if isinstance(outcome, Exception):
                future.set_exception(outcome)
            else:
                future.set_result(outcome)

        self.ask(question, tell)
        mean, std, seconds = await future
        took("inference", seconds)
        return question.answered(mean, std)

    def end(self) -> None:
        """Ask about what waits, now."""
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
        else:
            _tell(group[0][1], error)
        return
    for (_, tell), gaussian in zip(group, found, strict=True):
        _tell(tell, gaussian)


def _tell(tell: Tell, outcome: Gaussian | Exception) -> None:
    try:
        tell(outcome)
    except Exception:  # as above
        logger.exception("an answer was lost")


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
