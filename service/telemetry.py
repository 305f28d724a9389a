"""Logs as JSON lines, and a request id on every request: taken from ``X-Request-ID`` or made, returned, logged."""

import asyncio
import itertools
import logging
import re
import sys
import time
import uuid
from collections.abc import Awaitable, Callable
from datetime import UTC, datetime
from logging.config import dictConfig
from typing import Final, TextIO

import orjson
from pythonjsonlogger.core import RESERVED_ATTRS
from pythonjsonlogger.json import JsonFormatter
from starlette.types import ASGIApp, Message, Receive, Scope, Send

_ID_HEADER: Final = b"x-request-id"
_SAFE_ID = re.compile(rb"[A-Za-z0-9._-]{1,64}")
_HEAD: Final = {"level": "INFO", "logger": __name__, "message": "request"}
_ORJSON: Final = orjson.OPT_UTC_Z
_FLUSH_S: Final = 0.2
_FLUSH_LINES: Final = 512
_QUIET_ROUTES: Final = frozenset({"/livez", "/readyz"})

logger = logging.getLogger(__name__)
InternalError = Callable[[Scope, Receive, Send], Awaitable[None]]


def configure_logging(level: str) -> None:
    """One JSON line per event on standard error, uvicorn's own lines included."""
    dictConfig(
        {
            "version": 1,
            "disable_existing_loggers": False,
            "formatters": {
                "json": {
                    "()": JsonFormatter,
                    "format": "{levelname}{name}{message}",
                    "style": "{",
                    "timestamp": "time",
                    "rename_fields": {"levelname": "level", "name": "logger"},
                    "reserved_attrs": [*RESERVED_ATTRS, "color_message"],  # uvicorn's second form of its message
                }
            },
            "handlers": {"stderr": {"class": "logging.StreamHandler", "formatter": "json"}},
            "loggers": {"python_multipart": {"level": "ERROR"}},  # it repeats what is wrong in forms, byte by byte
            "root": {"level": level, "handlers": ["stderr"]},
        }
    )


class RequestLog:
    """A JSON line for every request, written together a few times a second: a write each costs as much as a prediction.

    Lines that are not written yet are lost when the process is killed; ``flush`` writes them at an orderly end.
    """

    def __init__(self, stream: TextIO | None = None) -> None:
        self._stream = stream
        self._lines: list[dict[str, object]] = []

    def add(self, line: dict[str, object]) -> None:
        """Take a line; it is written soon."""
        if not self._lines:
            asyncio.get_running_loop().call_later(_FLUSH_S, self.flush)
        self._lines.append(line)
        if len(self._lines) >= _FLUSH_LINES:
            self.flush()

    def flush(self) -> None:
        """Write what there is."""
        lines, self._lines = self._lines, []
        text = b"\n".join([orjson.dumps(_HEAD | line, option=_ORJSON) for line in lines])
        if lines:
            stream = self._stream or sys.stderr
            stream.write(text.decode() + "\n")
            stream.flush()


def request_id_of(scope: Scope) -> str:
    """The id of the request being answered."""
    return str(scope.get("state", {}).get("request_id", ""))


class RequestTelemetry:
    """The outermost ring: an id and a log line for every request, and a 500 for what nobody expected."""

    def __init__(self, app: ASGIApp, internal_error: InternalError, log: RequestLog) -> None:
        self.app = app
        self.log = log
        self._internal_error = internal_error
        self._process = uuid.uuid4().hex[:20]
        self._count = itertools.count()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one request."""
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        started = time.perf_counter()
        request_id = self._id_of(scope)
        state = scope.setdefault("state", {})
        state["request_id"] = request_id
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
            self._note(scope, status, (time.perf_counter() - started) * 1000.0, request_id)

    def _id_of(self, scope: Scope) -> str:
        """The caller's id when it is safe to log, else one of our own: random for the process, counted within it."""
        for name, value in scope["headers"]:
            if name == _ID_HEADER and _SAFE_ID.fullmatch(value):
                return str(value, "ascii")
        return f"{self._process}{next(self._count):012x}"

    def _note(self, scope: Scope, status: int, duration_ms: float, request_id: str) -> None:
        noted = scope["state"].get("log", {})
        template = noted.get("route") or str(getattr(scope.get("route"), "path", "unknown"))
        if not logger.isEnabledFor(logging.DEBUG if template in _QUIET_ROUTES else logging.INFO):
            return
        line = {
            "time": datetime.now(UTC),
            "request_id": request_id,
            "method": scope["method"],
            "route": template,
            "status": status,
            "duration_ms": round(duration_ms, 3),
        }
        self.log.add(line | noted)
