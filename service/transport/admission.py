"""Admission: bodies are complete, of bounded size and in bounded time, and concurrent requests are bounded.

The rings behind this one get each body in one piece. A slow client delays no other client: its request counts as in
flight only once its body is complete. A request over a limit is refused at once, so that its client can send it to
another instance.
"""

import asyncio
from collections import Counter
from dataclasses import dataclass

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.errors import BodyTooLargeError, CazslError, OverloadedError, SlowBodyError, TooManyRequestsError
from service.observability.records import record_of
from service.transport.callers import Callers
from service.transport.endpoints import header
from service.transport.problems import problem_response


@dataclass(frozen=True)
class AdmissionLimits:
    """Limits of one body, and of all concurrent requests.

    Attributes:
        body_bytes: maximum bytes of a body.
        body_s: maximum time until a body is complete, in s.
        in_flight: maximum number of concurrent requests.
        in_flight_per_caller: maximum number of concurrent requests of one caller. 0: no limit.
        held_bytes: maximum bytes of all bodies in memory.
    """

    body_bytes: int
    body_s: float
    in_flight: int
    in_flight_per_caller: int
    held_bytes: int


class WholeBody:
    """A body that was read already, as a ``receive`` of ASGI. Later calls give the messages that follow it."""

    __slots__ = ("_content", "_receive")

    def __init__(self, content: bytes, receive: Receive) -> None:
        self._content: bytes | None = content
        self._receive = receive

    async def __call__(self) -> Message:
        """Return the body, then the messages that follow."""
        if self._content is None:
            return await self._receive()
        content, self._content = self._content, None
        return {"type": "http.request", "body": content, "more_body": False}


class BodyDeadline:
    """Deadline of all tasks that read a body. They share one timer, since a timer each would cost more than reading.

    A late body is refused at most a quarter of the limit, or a second, after the deadline.
    """

    def __init__(self, limit_s: float) -> None:
        self._limit_s = limit_s
        self._reading: dict[asyncio.Task[None], float] = {}
        self._late: set[asyncio.Task[None]] = set()
        self._armed = False

    def __enter__(self) -> None:
        loop, task = asyncio.get_running_loop(), asyncio.current_task()
        if task is None:
            raise RuntimeError("a body must be read in a task")
        self._reading[task] = loop.time()
        if not self._armed:
            self._arm(loop)

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: object) -> None:
        task = asyncio.current_task()
        if task is None:
            return
        del self._reading[task]
        if task in self._late:
            self._late.discard(task)
            task.uncancel()
            raise SlowBodyError(self._limit_s)

    def _arm(self, loop: asyncio.AbstractEventLoop) -> None:
        self._armed = True
        loop.call_later(min(1.0, self._limit_s / 4.0), self._cancel_late, loop)

    def _cancel_late(self, loop: asyncio.AbstractEventLoop) -> None:
        self._armed = False
        latest = loop.time() - self._limit_s
        for task in [task for task, began in self._reading.items() if began < latest and task not in self._late]:
            self._late.add(task)
            task.cancel()
        if self._reading:
            self._arm(loop)


class Admission:
    """A ring that reads the body of every request within the limits, and counts the requests in flight."""

    def __init__(self, app: ASGIApp, limits: AdmissionLimits, callers: Callers) -> None:
        self._app = app
        self._callers = callers
        self._limits = limits
        self._deadline = BodyDeadline(limits.body_s)
        self.in_flight = 0
        self.held_bytes = 0
        self._running: Counter[str] = Counter()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one request, or refuse it."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        try:
            caller = record_of(scope).caller = self._callers.admit(scope)
            content = await self._read(scope, receive)
        except CazslError as error:
            await problem_response(scope, error)(scope, receive, send)
            return
        if content is None:  # the client has left
            return
        try:
            self._enter(caller)
        except CazslError as error:
            await problem_response(scope, error)(scope, receive, send)
        else:
            try:
                await self._app(scope, WholeBody(content, receive), send)
            finally:
                self._leave(caller)
        finally:
            self.held_bytes -= len(content)

    def admit(self, scope: Scope) -> str:
        """Admit a request that is answered at once, so that it never counts as in flight. Return its caller.

        Raises:
            MissingKeyError, ForbiddenError: its key does not admit it.
            OverloadedError, TooManyRequestsError: there are too many others.
        """
        caller = self._callers.admit(scope)
        self._check(caller)
        return caller

    def _check(self, caller: str) -> None:
        limits = self._limits
        if self.in_flight >= limits.in_flight:
            raise OverloadedError(f"{limits.in_flight} requests in flight")
        if limits.in_flight_per_caller and self._running[caller] >= limits.in_flight_per_caller:
            raise TooManyRequestsError(limits.in_flight_per_caller)

    def _enter(self, caller: str) -> None:
        self._check(caller)
        self._running[caller] += 1
        self.in_flight += 1

    def _leave(self, caller: str) -> None:
        self.in_flight -= 1
        self._running[caller] -= 1
        if not self._running[caller]:
            del self._running[caller]

    async def _read(self, scope: Scope, receive: Receive) -> bytes | None:
        """Return the complete body, counted among the held bytes, or None if the client left.

        Raises:
            BodyTooLargeError, SlowBodyError, OverloadedError: it is over a limit. Its bytes are no longer held.
        """
        limits = self._limits
        if declared_length(scope) > limits.body_bytes:
            raise BodyTooLargeError(limits.body_bytes)
        parts: list[bytes] = []
        size, more = 0, True
        with self._deadline:
            try:
                while more:
                    message = await receive()
                    if message["type"] != "http.request":
                        self.held_bytes -= size
                        return None
                    part, more = message.get("body", b""), message.get("more_body", False)
                    parts.append(part)
                    size += len(part)
                    self.held_bytes += len(part)
                    if size > limits.body_bytes:
                        raise BodyTooLargeError(limits.body_bytes)
                    if self.held_bytes > limits.held_bytes:
                        raise OverloadedError(f"{limits.held_bytes} buffered bytes of request bodies")
            except BaseException:
                self.held_bytes -= size
                raise
        return parts[0] if len(parts) == 1 else b"".join(parts)


def declared_length(scope: Scope) -> int:
    """Return the declared length of the body in bytes, or 0 if none is declared."""
    length = header(scope["headers"], b"content-length")
    return int(length[:18]) if length is not None and length.isdigit() else 0
