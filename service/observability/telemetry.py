"""Telemetry of requests: a request id, a log line and a count for each.

The id is that of ``X-Request-ID`` if it is safe to log, else a new one. The answer returns it. The trace of the caller
(W3C Trace Context, header ``traceparent``) is logged if it is valid.
"""

import itertools
import logging
import re
import time
import uuid
from collections.abc import Callable
from datetime import UTC, datetime
from typing import Final, Protocol

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.background.supervision import ENDINGS
from service.observability.logs import REQUEST_LOGGER, RequestLog
from service.observability.records import UNKNOWN_ROUTE, RequestRecord, attach_record
from service.observability.timings import collect_timings

_ID_HEADER: Final = b"x-request-id"
_TRACE_HEADER: Final = b"traceparent"
_TRACE = re.compile(rb"(?!ff)[0-9a-f]{2}-(?!0{32})([0-9a-f]{32})-(?!0{16})([0-9a-f]{16})-[0-9a-f]{2}(?:-.*)?")
_TRACE_LENGTH: Final = 55
_SAFE_ID = re.compile(rb"[A-Za-z0-9._-]{1,64}")
_QUIET_ROUTES: Final = frozenset({"/livez", "/readyz", "/metrics"})

logger = logging.getLogger(__name__)
_requests = logging.getLogger(REQUEST_LOGGER)
Problem = Callable[[Scope, BaseException], ASGIApp]


class RequestObserver(Protocol):
    """A counter of requests."""

    def note(self, record: RequestRecord) -> None:
        """Count a request that was answered, or whose client left, even if its line is not logged."""
        ...


class RequestTelemetry:
    """The outermost ring: an id, a log line and a count for every request, and a 500 for unexpected exceptions."""

    def __init__(self, app: ASGIApp, problem: Problem, log: RequestLog, observer: RequestObserver) -> None:
        """Create the ring.

        Args:
            app: the next ring.
            problem: logs an exception that the application did not expect, and makes its answer.
            log: log of requests.
            observer: counts requests.
        """
        self.app = app
        self.log = log
        self._observer = observer
        self._problem = problem
        self._process = uuid.uuid4().hex[:20]
        self._count = itertools.count()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one request."""
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        began = time.perf_counter()
        record = self.begin(scope)
        collect_timings(record.timings)
        header = id_header(record)

        async def send_with_id(message: Message) -> None:
            """Add the request's id to the head of the answer."""
            if message["type"] == "http.response.start":
                record.status = message["status"]
                message = {**message, "headers": [*message.get("headers", ()), header]}
            await send(message)

        try:
            await self.app(scope, receive, send_with_id)
        except ENDINGS:
            raise
        except BaseException as error:  # a panic of a library in native code is no Exception
            answer = self._problem(scope, error)
            if record.status:  # half of the answer is sent: only the end of the connection shows that it failed
                raise
            await answer(scope, receive, send_with_id)
        finally:
            if record.route == UNKNOWN_ROUTE:
                record.route = str(getattr(scope.get("route"), "path", UNKNOWN_ROUTE))
            self.end(record, time.perf_counter() - began)

    def begin(self, scope: Scope) -> RequestRecord:
        """Create the record of a request and attach it to its scope."""
        request_id, trace = None, None
        for name, value in scope["headers"]:
            if name == _ID_HEADER and request_id is None and _SAFE_ID.fullmatch(value):
                request_id = str(value, "ascii")
            elif name == _TRACE_HEADER and trace is None:
                trace = _trace_of(value)
        record = RequestRecord(request_id or self.new_id(), scope["method"], trace)
        attach_record(scope, record)
        return record

    def new_id(self) -> str:
        """Return an id of ours, which is random per process and counts within it."""
        return f"{self._process}{next(self._count):012x}"

    def end(self, record: RequestRecord, duration_s: float) -> None:
        """Count and log a request that was answered, or whose client left."""
        record.duration_s = duration_s
        record.timings = record.timings[:]  # a thread that missed the deadline goes on appending to the other list
        record.time = datetime.now(UTC)
        try:
            self._observer.note(record)
            if _requests.isEnabledFor(logging.DEBUG if record.route in _QUIET_ROUTES else logging.INFO):
                self.log.add(record)
        except Exception:  # a fault of metrics or logs is none of the request
            logger.exception("a request was not counted", extra={"request_id": record.request_id})


def id_header(record: RequestRecord) -> tuple[bytes, bytes]:
    """Return the header with the request id."""
    return _ID_HEADER, record.request_id.encode()


def _trace_of(value: bytes) -> tuple[str, str] | None:
    """Return trace id and span id of a ``traceparent`` header, or None if it is not valid."""
    found = _TRACE.fullmatch(value)
    if found and (len(value) == _TRACE_LENGTH or not value.startswith(b"00")):  # only later versions may be longer
        return found[1].decode(), found[2].decode()
    return None
