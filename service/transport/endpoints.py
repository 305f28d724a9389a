"""Endpoints: the one way from the bytes of a request to the bytes of its answer.

An ``Endpoint`` declares how its requests are checked, read and turned into a query. ``Endpoints`` is the table of all
endpoints, with the models, threads and micro-batches that an answer needs. All callers use it: the connection
(single pushes), the ring in front of the framework, and the framework's own routes. The in-process client uses the
endpoints themselves. A request, good or refused, is read once. Its key is checked before, by ``admission``.
"""

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from functools import partial
from typing import Any, Final, Generic, TypeVar

from service.inference.loaded_models import LoadedModels
from service.inference.micro_batching import CALL_S, MicroBatcher
from service.inference.query import Answer, Query
from service.inference.snapshot import Snapshot
from service.transport.loop_turns import LoopTurns
from service.transport.threads import ThreadPool
from service.turns import pause

R = TypeVar("R")
Headers = Sequence[tuple[bytes, bytes]]
LIGHT_BYTES: Final = 16 * 1024  # to read them takes about as long as to pass them to a thread
LIGHT_PUSHES: Final = 256  # to predict them takes about as long as to pass them to a thread
BODY_GROWTH: Final = 10  # a body of JSON takes up to this many times its bytes, once it is read
NO_PARAMETERS: Final[Mapping[str, str]] = {}


class Weight(Enum):
    """Weight of a request that was read. It decides where the request is answered."""

    SINGLE = (
        "one push: predicted in the micro-batch of this iteration of the event loop, or by a slow model in a thread"
    )
    LIGHT = "few contexts: encoded in the event loop; many pushes, or those of a slow model, are predicted in a thread"
    HEAVY = "images or many contexts: encoded and predicted in a thread"


@dataclass(frozen=True, slots=True)
class HttpRequest:
    """Request of HTTP, by the parts that decide its answer.

    Attributes:
        headers: names in lower case, and values.
        content: the whole body.
        parameters: parameters of the path.
        caller: whom its work counts for, see ``callers``.
    """

    headers: Headers
    content: bytes
    parameters: Mapping[str, str]
    caller: str = ""


def header(headers: Headers, name: bytes) -> bytes | None:
    """Return the first header of this name, which is in lower case as in ASGI, or None."""
    for key, value in headers:
        if key == name:
            return value
    return None


@dataclass(frozen=True, slots=True)
class Endpoint(Generic[R]):
    """Endpoint: a POST route that predicts.

    Attributes:
        path: template of the path, which is also its label in logs and metrics.
        check: checks the headers in the event loop, before the body is read. Raises a RequestError.
        read: reads the request from the body. Raises a RequestError.
        ask: returns the query of a request to one of the models, or an answer if no model is needed.
        weigh: returns the weight of a request that was read.
        is_read_quickly: returns True if the event loop may read this body. Otherwise a thread reads and predicts.
        held_bytes: returns the memory that a body takes at most once it is read, without the pixels of images.
    """

    path: str
    check: Callable[[Headers], None]
    read: Callable[[HttpRequest], R]
    ask: Callable[[Snapshot, R], Query | Answer]
    weigh: Callable[[R], Weight]
    is_read_quickly: Callable[[HttpRequest], bool]
    held_bytes: Callable[[HttpRequest], int] = lambda request: BODY_GROWTH * len(request.content)

    def answer(self, models: Snapshot, request: HttpRequest) -> Answer:
        """Read, ask, predict and encode in this thread.

        Raises:
            RequestError, ModelNotReadyError, PredictionError: the request cannot be answered.
        """
        read = self.read(request)
        pause()
        return self.answer_read(models, read)

    def answer_read(self, models: Snapshot, request: R) -> Answer:
        """Ask, predict and encode a request that was read, in this thread."""
        asked = self.ask(models, request)
        return asked if isinstance(asked, Answer) else asked.answer()


class Endpoints:
    """The table of endpoints, with the models and threads that answers need.

    Attributes:
        micro_batcher: predicts the single pushes of each event loop iteration.
        turns: of the requests that the event loop works on.
    """

    def __init__(self, endpoints: Iterable[Endpoint[Any]], models: LoadedModels, threads: ThreadPool) -> None:
        self._table = {endpoint.path: endpoint for endpoint in endpoints}
        self._exact = {path: endpoint for path, endpoint in self._table.items() if "{" not in path}
        self._patterns = [(_pattern(path), endpoint) for path, endpoint in self._table.items() if "{" in path]
        self._models = models
        self._threads = threads
        self.turns = LoopTurns()
        self.micro_batcher = MicroBatcher()

    def at(self, template: str) -> Endpoint[Any]:
        """Return the endpoint with this path template.

        Raises:
            KeyError: there is none.
        """
        return self._table[template]

    def find(self, path: str) -> tuple[Endpoint[Any], Mapping[str, str]] | None:
        """Return the endpoint of a path with the parameters in the path, or None."""
        endpoint = self._exact.get(path)
        if endpoint is not None:
            return endpoint, NO_PARAMETERS
        for pattern, candidate in self._patterns:
            found = pattern.fullmatch(path)
            if found is not None:
                return candidate, found.groupdict()
        return None

    async def answer(self, endpoint: Endpoint[Any], request: HttpRequest) -> Answer:
        """Answer a request in the event loop, in a micro-batch or in a thread.

        Raises:
            RequestError: the request cannot be answered as it was sent.
            ModelNotReadyError: no model is loaded.
            OverloadedError, DeadlineError: the threads are busy.
            PredictionError: the runtime failed.
        """
        endpoint.check(request.headers)
        models = self._models.snapshot
        run = partial(self._threads.run, caller=request.caller, size_bytes=endpoint.held_bytes(request))
        if not endpoint.is_read_quickly(request):
            return await run(endpoint.answer, models, request)
        read = endpoint.read(request)
        weight = endpoint.weigh(read)
        if weight is Weight.HEAVY:
            return await run(endpoint.answer_read, models, read)
        asked = endpoint.ask(models, read)
        if isinstance(asked, Answer):
            return asked
        if len(asked.pushers) <= LIGHT_PUSHES and asked.seconds() <= CALL_S:
            return await self.micro_batcher.answer(asked) if weight is Weight.SINGLE else asked.answer()
        # Only the runtime goes to the thread: Python code needs the interpreter lock, and to exchange it costs time.
        predicted = await run(asked.predict)
        await self.turns.wait()
        return asked.encode(*predicted)

    def query_single(self, endpoint: Endpoint[Any], request: HttpRequest) -> Query | None:
        """Return the query of a single push, to be submitted to the micro-batcher, or None if it needs a thread.

        The caller has checked the headers: only a plain request takes the shortcut.

        Raises:
            RequestError, ModelNotReadyError: see ``answer``.
        """
        read = endpoint.read(request)
        if endpoint.weigh(read) is not Weight.SINGLE:
            return None
        asked = endpoint.ask(self._models.snapshot, read)
        return None if isinstance(asked, Answer) or asked.model.cost.call_s > CALL_S else asked


def _pattern(template: str) -> re.Pattern[str]:
    """Return the pattern of a path template. A parameter matches any text without a slash, as in the framework."""
    parts = re.split(r"\{(\w+)\}", template)
    literals, names = parts[::2], parts[1::2]
    tail = "".join(f"(?P<{name}>[^/]+){re.escape(literal)}" for name, literal in zip(names, literals[1:], strict=True))
    return re.compile(re.escape(literals[0]) + tail)
