"""Logs as JSON lines, and a request id on every request: taken from ``X-Request-ID`` or made, returned, logged.

The trace that a caller is in (W3C Trace Context, header ``traceparent``) is logged too, when it is one.
"""

import itertools
import logging
import re
import time
import uuid
from collections.abc import Awaitable, Callable, Mapping
from datetime import UTC, datetime
from typing import Any, Final, Protocol, get_args

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.observability.logs import RequestLog
from service.observability.timings import Part, Parts, listen

_ID_HEADER: Final = b"x-request-id"
_TRACE_HEADER: Final = b"traceparent"
_TRACE = re.compile(rb"(?!ff)[0-9a-f]{2}-(?!0{32})([0-9a-f]{32})-(?!0{16})([0-9a-f]{16})-[0-9a-f]{2}(?:-.*)?")
_TRACE_LENGTH: Final = 55
_SAFE_ID = re.compile(rb"[A-Za-z0-9._-]{1,64}")
_QUIET_ROUTES: Final = frozenset({"/livez", "/readyz", "/metrics"})
_PART_FIELDS: Final[Mapping[Part, str]] = {part: f"{part}_ms" for part in get_args(Part)}
_NOTHING: Final[Mapping[str, Any]] = {}

logger = logging.getLogger(__name__)
InternalError = Callable[[Scope, Receive, Send], Awaitable[None]]


def request_id_of(scope: Scope) -> str:
    """The id of the request being answered."""
    return str(scope.get("state", {}).get("request_id", ""))


def route_of(scope: Scope) -> str:
    """The template of the route that answered, never the path that was asked for."""
    return scope["state"].get("log", _NOTHING).get("route") or str(getattr(scope.get("route"), "path", "unknown"))


class RequestObserver(Protocol):
    """Whoever counts requests."""

    def note(self, line: Mapping[str, Any]) -> None:
        """A request was answered, or its client left; this is its line of the log, whether or not it is written."""
        ...


class RequestTelemetry:
    """The outermost ring: an id, a log line and a count for every request, and a 500 for what nobody expected."""

    def __init__(self, app: ASGIApp, internal_error: InternalError, log: RequestLog, observer: RequestObserver) -> None:
        self.app = app
        self.log = log
        self._observer = observer
        self._internal_error = internal_error
        self._process = uuid.uuid4().hex[:20]
        self._count = itertools.count()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one request."""
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        started = time.perf_counter()
        request_id = self.begin(scope)
        parts: Parts = []
        listen(parts)
        header = (_ID_HEADER, request_id.encode())
        status = 0

        async def send_with_id(message: Message) -> None:
            """Add the request's id to what is sent."""
            nonlocal status
            if message["type"] == "http.response.start":
                status = message["status"]
                message = {**message, "headers": [*message.get("headers", ()), header]}
            await send(message)

        try:
            await self.app(scope, receive, send_with_id)
        except Exception:
            logger.exception("request failed", extra={"request_id": request_id})
            if status:  # the answer is half sent: only cutting the connection tells the client
                raise
            await self._internal_error(scope, receive, send_with_id)
        finally:
            self.note(scope, status, time.perf_counter() - started, parts)

    def begin(self, scope: Scope) -> str:
        """Give a request its id."""
        request_id: str = self._id_of(scope)
        scope.setdefault("state", {})["request_id"] = request_id
        return request_id

    def _id_of(self, scope: Scope) -> str:
        """The caller's id when it is safe to log, else one of our own: random for the process, counted within it."""
        for name, value in scope["headers"]:
            if name == _ID_HEADER and _SAFE_ID.fullmatch(value):
                return str(value, "ascii")
        return f"{self._process}{next(self._count):012x}"

    def note(self, scope: Scope, status: int, duration_s: float, parts: Parts) -> None:
        """Count and log a request that began, and was answered or left."""
        state = scope["state"]
        template = route_of(scope)
        line: dict[str, Any] = {
            "time": datetime.now(UTC),
            "request_id": state["request_id"],
            "method": scope["method"],
            "route": template,
            "status": status,
            "duration_ms": round(duration_s * 1000.0, 4),
        }
        for part, seconds in parts:
            name = _PART_FIELDS[part]
            line[name] = round(line.get(name, 0.0) + seconds * 1000.0, 4)
        if "refusal" in state:
            line["code"] = state["refusal"]
        line |= _trace_of(scope) | state.get("log", _NOTHING)
        self._observer.note(line)
        if logger.isEnabledFor(logging.DEBUG if template in _QUIET_ROUTES else logging.INFO):
            self.log.add(line)


def _trace_of(scope: Scope) -> dict[str, str]:
    """The trace and the span of the caller, as OpenTelemetry names them in logs; nothing when there is none."""
    for name, value in scope["headers"]:
        found = _TRACE.fullmatch(value) if name == _TRACE_HEADER else None
        if found and (len(value) == _TRACE_LENGTH or not value.startswith(b"00")):  # only later versions say more
            return {"trace_id": found[1].decode(), "span_id": found[2].decode()}
    return {}
