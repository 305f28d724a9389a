"""Logs as JSON lines, and a request id on every request: taken from ``X-Request-ID`` or made, returned, logged."""

import logging
import re
import time
import uuid
from collections.abc import Awaitable, Callable
from logging.config import dictConfig
from typing import Final

from pythonjsonlogger.core import RESERVED_ATTRS
from pythonjsonlogger.json import JsonFormatter
from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

REQUEST_ID_HEADER: Final = "X-Request-ID"
_SAFE_ID = re.compile(r"[A-Za-z0-9._-]{1,64}")
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
            "root": {"level": level, "handlers": ["stderr"]},
        }
    )


def request_id_of(scope: Scope) -> str:
    """The id of the request being answered."""
    return str(scope.get("state", {}).get("request_id", ""))


class RequestTelemetry:
    """The outermost ring: an id and a log line for every request, and a 500 for what nobody expected."""

    def __init__(self, app: ASGIApp, internal_error: InternalError) -> None:
        self.app = app
        self._internal_error = internal_error

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one request."""
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        given = Headers(scope=scope).get(REQUEST_ID_HEADER, "")
        request_id = given if _SAFE_ID.fullmatch(given) else uuid.uuid4().hex
        scope.setdefault("state", {})["request_id"] = request_id
        started = time.perf_counter()
        status = 0

        async def send_with_id(message: Message) -> None:
            nonlocal status
            if message["type"] == "http.response.start":
                status = message["status"]
                MutableHeaders(scope=message)[REQUEST_ID_HEADER] = request_id
            await send(message)

        try:
            await self.app(scope, receive, send_with_id)
        except Exception:
            logger.exception("request failed", extra={"request_id": request_id})
            if status:  # the answer is half sent: only cutting the connection tells the client
                raise
            await self._internal_error(scope, receive, send_with_id)
        finally:
            self._log(scope, status, (time.perf_counter() - started) * 1000.0, request_id)

    def _log(self, scope: Scope, status: int, duration_ms: float, request_id: str) -> None:
        route = scope.get("route")
        template = str(getattr(route, "path", "unknown"))
        level = logging.DEBUG if template in _QUIET_ROUTES else logging.INFO
        if not logger.isEnabledFor(level):
            return
        line = {
            "request_id": request_id,
            "method": scope["method"],
            "route": template,
            "status": status,
            "duration_ms": round(duration_ms, 3),
            **scope["state"].get("log", {}),
        }
        logger.log(level, "request", extra=line)
