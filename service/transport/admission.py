"""What comes in, before anyone works on it: whole bodies only, of bounded size and in bounded time, so many at once.

Everything behind this ring gets its body in one piece. A slow client holds up nobody: it is counted as a request in
flight only once its body is here. What is too much is refused at once, so that the caller can go elsewhere.
"""

import asyncio
from collections import Counter
from dataclasses import dataclass

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.errors import BodyTooLargeError, CazslError, OverloadedError, SlowBodyError, TooManyRequestsError
from service.transport.keys import authorization_of
from service.transport.problems import problem_response


@dataclass(frozen=True)
class IntakeLimits:
    """What a request may bring, and how much may be held at once."""

    body_bytes: int
    body_s: float
    in_flight: int
    in_flight_per_caller: int
    held_bytes: int


class WholeBody:
    """A ``receive`` that gives a body that was read already, then what follows it."""

    __slots__ = ("_content", "_receive")

    def __init__(self, content: bytes, receive: Receive) -> None:
        self._content: bytes | None = content
        self._receive = receive

    async def __call__(self) -> Message:
        """The body, once."""
        if self._content is None:
            return await self._receive()
        content, self._content = self._content, None
        return {"type": "http.request", "body": content, "more_body": False}


class Patience:
    """Bounds how long tasks read: one timer looks at all of them, since a timer each costs more than reading does.

    A body that is late is ended within a quarter of the limit, or a second, after it.
    """

    def __init__(self, limit_s: float) -> None:
        self._limit_s = limit_s
        self._reading: dict[asyncio.Task[None], float] = {}
        self._late: set[asyncio.Task[None]] = set()
        self._armed = False

    def __enter__(self) -> None:
        loop, task = asyncio.get_running_loop(), asyncio.current_task()
        if task is None:
            raise RuntimeError("a body is read outside of a task")
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
        loop.call_later(min(1.0, self._limit_s / 4.0), self._look, loop)

    def _look(self, loop: asyncio.AbstractEventLoop) -> None:
        self._armed = False
        latest = loop.time() - self._limit_s
        for task in [task for task, began in self._reading.items() if began < latest and task not in self._late]:
            self._late.add(task)
            task.cancel()
        if self._reading:
            self._arm(loop)


class Intake:
    """Reads the body of every request, within the limits, and counts who is being answered."""

    def __init__(self, app: ASGIApp, limits: IntakeLimits) -> None:
        self._app = app
        self._limits = limits
        self._patience = Patience(limits.body_s)
        self.in_flight = 0
        self.held_bytes = 0
        self._callers: Counter[object] = Counter()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one request, or refuse it."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        try:
            content = await self._read(scope, receive)
        except CazslError as error:
            await problem_response(scope, error)(scope, receive, send)
            return
        if content is None:  # the client has gone
            return
        try:
            caller = self._admit(scope)
        except CazslError as error:
            await problem_response(scope, error)(scope, receive, send)
        else:
            self.in_flight += 1
            try:
                await self._app(scope, WholeBody(content, receive), send)
            finally:
                self.in_flight -= 1
                self._leave(caller)
        finally:
            self.held_bytes -= len(content)

    def refusal(self, scope: Scope) -> CazslError | None:
        """Why a request cannot be answered now, if it cannot."""
        limits = self._limits
        if self.in_flight >= limits.in_flight:
            return OverloadedError(f"{limits.in_flight} requests in flight")
        if limits.in_flight_per_caller and self._callers[self._caller(scope)] >= limits.in_flight_per_caller:
            return TooManyRequestsError(limits.in_flight_per_caller)
        return None

    def _caller(self, scope: Scope) -> object:
        """Who asks, as far as that is counted."""
        if not self._limits.in_flight_per_caller:
            return None
        return authorization_of(scope["headers"]) or (scope["client"] or ("",))[0]

    def _admit(self, scope: Scope) -> object:
        refusal = self.refusal(scope)
        if refusal is not None:
            raise refusal
        caller = self._caller(scope)
        if caller is not None:
            self._callers[caller] += 1
        return caller

    def _leave(self, caller: object) -> None:
        if caller is None:
            return
        self._callers[caller] -= 1
        if not self._callers[caller]:
            del self._callers[caller]

    async def _read(self, scope: Scope, receive: Receive) -> bytes | None:
        """The whole body, counted among what is held; None when the client went away.

        Raises:
            BodyTooLargeError, SlowBodyError, OverloadedError: it is over a limit; none of it is held any more.
        """
        limits = self._limits
        if declared_length(scope) > limits.body_bytes:
            raise BodyTooLargeError(limits.body_bytes)
        parts: list[bytes] = []
        size, more = 0, True
        with self._patience:
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
                        raise OverloadedError("as many bytes of requests as it may hold")
            except BaseException:
                self.held_bytes -= size
                raise
        return parts[0] if len(parts) == 1 else b"".join(parts)


def declared_length(scope: Scope) -> int:
    """How many bytes a body says that it has; 0 when it does not say."""
    for name, value in scope["headers"]:
        if name == b"content-length" and value.isdigit():
            return int(value[:18])
    return 0
