"""Endpoints: the one way from the bytes of a request to the bytes of its answer.

An endpoint says how its requests are checked, read and asked of a model. ``Endpoints`` is the table of all of them with
the means to answer: models, threads, micro-batches and API keys. Everybody who answers goes through it: the connection
(single pushes), the ring in front of the framework, the framework's own routes, and the in-process client. A request,
good or refused, is read once and its key checked once.
"""

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Any, Final, Generic, TypeVar

from service.inference.loaded_models import LoadedModels
from service.inference.micro_batching import MicroBatcher
from service.inference.query import Answer, Query
from service.inference.snapshot import Snapshot
from service.transport.keys import Keys, Scope
from service.transport.threads import ThreadPool

R = TypeVar("R")
Headers = Sequence[tuple[bytes, bytes]]
LIGHT_BYTES: Final = 16 * 1024  # read in about the time that handing them to a thread takes
LIGHT_PUSHES: Final = 256  # predicted in about the time that handing them to a thread takes
NO_PARAMETERS: Final[Mapping[str, str]] = {}


class Weight(Enum):
    """The cost of a request that was read, and so the place where it is answered."""

    SINGLE = "one push: predicted in the micro-batch of this iteration of the event loop"
    LIGHT = "few contexts: encoded in the event loop; more than LIGHT_PUSHES pushes are predicted in a thread"
    HEAVY = "images or many contexts: encoded and predicted in a thread"


@dataclass(frozen=True, slots=True)
class HttpRequest:
    """The parts of a request that decide its answer."""

    headers: Headers
    content: bytes
    parameters: Mapping[str, str]  # of the path


def header(headers: Headers, name: bytes) -> bytes | None:
    """Return the first header of this name, in lower case as ASGI has it."""
    for key, value in headers:
        if key == name:
            return value
    return None


@dataclass(frozen=True, slots=True)
class Endpoint(Generic[R]):
    """A POST route that predicts.

    Attributes:
        path: its template, which is also its label in logs and metrics.
        check: raises where the headers are not acceptable. Runs in the event loop, before the body is read.
        read: the request of the body. Raises InvalidRequestError, MalformedBodyError and the like.
        ask: the query of a request to the models, or an answer where no model is needed.
        weigh: the weight of a request that was read.
        is_read_quickly: whether the event loop may read this body; else a thread reads, encodes and predicts.
    """

    path: str
    check: Callable[[Headers], None]
    read: Callable[[HttpRequest], R]
    ask: Callable[[Snapshot, R], Query | Answer]
    weigh: Callable[[R], Weight]
    is_read_quickly: Callable[[HttpRequest], bool]

    def answer(self, models: Snapshot, request: HttpRequest) -> Answer:
        """Read, ask, predict and encode in this thread.

        Raises:
            RequestError, ModelNotReadyError, PredictionError: the request cannot be answered.
        """
        return self.answer_read(models, self.read(request))

    def answer_read(self, models: Snapshot, request: R) -> Answer:
        """Ask, predict and encode in this thread, for a request that was read."""
        asked = self.ask(models, request)
        return asked if isinstance(asked, Answer) else asked.answer()


class Endpoints:
    """The table of endpoints, and the means to answer.

    Attributes:
        micro_batcher: predicts single pushes.
    """

    def __init__(
        self, endpoints: Iterable[Endpoint[Any]], models: LoadedModels, threads: ThreadPool, keys: Keys
    ) -> None:
        self._table = {endpoint.path: endpoint for endpoint in endpoints}
        self._exact = {path: endpoint for path, endpoint in self._table.items() if "{" not in path}
        self._patterns = [(_pattern(path), endpoint) for path, endpoint in self._table.items() if "{" in path]
        self._models = models
        self._threads = threads
        self._keys = keys
        self.micro_batcher = MicroBatcher()

    def at(self, template: str) -> Endpoint[Any]:
        """Return the endpoint with this path template.

        Raises:
            KeyError: there is none.
        """
        return self._table[template]

    def find(self, path: str) -> tuple[Endpoint[Any], Mapping[str, str]] | None:
        """Return the endpoint of a path, and the parameters of the path."""
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
        self._admit(request.headers)
        endpoint.check(request.headers)
        models = self._models.snapshot
        if not endpoint.is_read_quickly(request):
            return await self._threads.run(endpoint.answer, models, request)
        read = endpoint.read(request)
        weight = endpoint.weigh(read)
        if weight is Weight.HEAVY:
            return await self._threads.run(endpoint.answer_read, models, read)
        asked = endpoint.ask(models, read)
        if isinstance(asked, Answer):
            return asked
        if weight is Weight.SINGLE:
            return await self.micro_batcher.answer(asked)
        if len(asked.pushers) <= LIGHT_PUSHES:
            return asked.answer()
        # The runtime alone goes to the thread: Python code holds one lock in any thread, and passing it on costs time.
        return asked.encode(*await self._threads.run(asked.predict))

    def query_single(self, endpoint: Endpoint[Any], request: HttpRequest) -> Query | None:
        """Return the query of a single push, to be submitted to the micro-batcher; None where it needs a thread.

        The caller has checked the headers: only a plain request takes the shortcut.

        Raises:
            RequestError, ModelNotReadyError: see ``answer``.
        """
        self._admit(request.headers)
        read = endpoint.read(request)
        if endpoint.weigh(read) is not Weight.SINGLE:
            return None
        asked = endpoint.ask(self._models.snapshot, read)
        return None if isinstance(asked, Answer) else asked

    def _admit(self, headers: Headers) -> None:
        if self._keys.wanted:
            self._keys.admit(header(headers, b"authorization"), Scope.PREDICT)


def _pattern(template: str) -> re.Pattern[str]:
    """Return the pattern of a path template. A parameter is any text without a slash, as in the framework."""
    parts = re.split(r"\{(\w+)\}", template)
    literals, names = parts[::2], parts[1::2]
    tail = "".join(f"(?P<{name}>[^/]+){re.escape(literal)}" for name, literal in zip(names, literals[1:], strict=True))
    return re.compile(re.escape(literals[0]) + tail)
