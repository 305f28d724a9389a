"""Admission: heads are valid, keys are known, and bodies and concurrent requests are bounded, in sum and per caller.

The rings behind this one get each body in one piece. A slow client delays no other client: its request counts as in
flight from the end of its body to the begin of its answer. A request over a limit is refused at once, so that its
client can send it to another instance. Routes of health have a quota of their own: they answer under any load.
"""

import asyncio
from dataclasses import dataclass
from typing import Final, Self

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.errors import BodyTooLargeError, CazslError, OverloadedError, SlowBodyError, TooManyRequestsError
from service.transport.callers import Callers
from service.transport.heads import checked_headers, declared_length, head_bytes
from service.transport.loop_turns import LoopTurns
from service.transport.problems import problem_response
from service.transport.shares import Shares, usual_share

HEALTH: Final = frozenset(("/livez", "/readyz", "/v2/health/live", "/v2/health/ready", "/metrics"))
_HEALTH_QUOTA: Final = 64
_HEALTH_BODY_BYTES: Final = 4096


@dataclass(frozen=True)
class AdmissionLimits:
    """Limits of one body, and of all concurrent requests.

    Attributes:
        body_bytes: maximum bytes of a body.
        body_s: maximum time until a body is complete, in s.
        in_flight: maximum number of concurrent requests.
        in_flight_per_caller: maximum number of concurrent requests of one caller. 0: three quarters of all.
        held_bytes: maximum bytes of all requests in memory. One caller may hold three quarters.
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


class InFlight:
    """A request in flight, as a ``send`` of ASGI. It no longer counts once its answer begins to leave."""

    __slots__ = ("_caller", "_counted", "_send")

    def __init__(self, counted: Shares, caller: str, send: Send) -> None:
        counted.take(caller)
        self._counted: Shares | None = counted
        self._caller = caller
        self._send = send

    async def __call__(self, message: Message) -> None:
        """Send a message."""
        self.end()
        await self._send(message)

    def end(self) -> None:
        """Count the request no longer."""
        counted, self._counted = self._counted, None
        if counted is not None:
            counted.give(self._caller)


class Hold:
    """The bytes of one request that are in memory, to be counted among those of all."""

    __slots__ = ("_caller", "_count", "_held")

    def __init__(self, held: Shares | None, caller: str) -> None:
        self._held = held  # None: they are not counted
        self._caller = caller
        self._count = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.release()

    def add(self, count: int) -> None:
        """Hold more bytes.

        Raises:
            OverloadedError: there are too many. These are not held.
        """
        if self._held is not None:
            self._held.take(self._caller, count)
            self._count += count

    def release(self) -> None:
        """Release all bytes."""
        count, self._count = self._count, 0
        if self._held is not None and count:
            self._held.give(self._caller, count)


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
    """A ring that checks the head and reads the body of every request within the limits, and counts those in flight.

    Attributes:
        held: bytes of requests in memory. Connections count those of incomplete heads here too.
        body_bytes: maximum bytes of a body.
        body_s: maximum time until a body is complete, in s.
    """

    def __init__(self, app: ASGIApp, limits: AdmissionLimits, callers: Callers, turns: LoopTurns | None = None) -> None:
        self._app = app
        self._callers = callers
        self.body_bytes = limits.body_bytes
        self.body_s = limits.body_s
        self._deadline = BodyDeadline(limits.body_s)
        self._turns = turns or LoopTurns()
        self._in_flight = Shares(
            limits.in_flight,
            limits.in_flight_per_caller or usual_share(limits.in_flight),
            lambda limit: OverloadedError(f"{limit} requests in flight"),
            TooManyRequestsError,
        )
        self.held = Shares(
            limits.held_bytes,
            usual_share(limits.held_bytes),
            lambda limit: OverloadedError(f"{limit} buffered bytes of request bodies"),
            lambda limit: OverloadedError(f"{limit} buffered bytes of the request bodies of one caller"),
        )
        self._health = Shares(
            _HEALTH_QUOTA,
            usual_share(_HEALTH_QUOTA),
            lambda limit: OverloadedError(f"{limit} requests for health"),
            TooManyRequestsError,
        )

    @property
    def in_flight(self) -> int:
        """Return the number of requests that are being answered."""
        return self._in_flight.total

    @property
    def held_bytes(self) -> int:
        """Return the bytes of requests in memory."""
        return self.held.total

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one request, or refuse it."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        try:
            scope["headers"] = checked_headers(scope)
            caller = self._callers.admit(scope)
        except CazslError as error:
            await problem_response(scope, error)(scope, receive, send)
            return
        is_health = scope["path"] in HEALTH
        with Hold(None if is_health else self.held, caller) as hold:
            try:
                content = await self._read(scope, receive, hold, _HEALTH_BODY_BYTES if is_health else self.body_bytes)
                if content is None:  # the client has left
                    return
                admitted = InFlight(self._health if is_health else self._in_flight, caller, send)
            except CazslError as error:
                hold.release()
                await problem_response(scope, error)(scope, receive, send)
                return
            try:
                if not is_health:
                    await self._turns.wait()
                await self._app(scope, WholeBody(content, receive), admitted)
            finally:
                admitted.end()

    def known_caller(self, scope: Scope) -> str | None:
        """Return the caller of this head, or None if its key does not admit it. Then this ring refuses the request."""
        try:
            return self._callers.admit(scope)
        except CazslError:
            return None

    def check(self, caller: str) -> None:
        """Admit a request that is answered at once, so that it never counts as in flight.

        Raises:
            OverloadedError, TooManyRequestsError: there are too many others.
        """
        self._in_flight.check(caller)

    async def _read(self, scope: Scope, receive: Receive, hold: Hold, limit_bytes: int) -> bytes | None:
        """Return the complete body, which is held with its head, or None if the client left.

        Raises:
            BodyTooLargeError, SlowBodyError, OverloadedError: it is over a limit.
        """
        if declared_length(scope) > limit_bytes:
            raise BodyTooLargeError(limit_bytes)
        hold.add(head_bytes(scope))
        parts: list[bytes] = []
        size, more = 0, True
        with self._deadline:
            while more:
                message = await receive()
                if message["type"] != "http.request":
                    return None
                part, more = message.get("body", b""), message.get("more_body", False)
                parts.append(part)
                size += len(part)
                if size > limit_bytes:
                    raise BodyTooLargeError(limit_bytes)
                hold.add(len(part))
        return parts[0] if len(parts) == 1 else b"".join(parts)
