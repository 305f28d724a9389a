"""Connections with the shortcut: a plain single push is answered without ASGI.

If anything in a request is unusual, it is passed to uvicorn unchanged. That is possible until its body is complete.
"""

import asyncio
from typing import Any, cast

from starlette.types import Scope
from uvicorn.protocols.http.httptools_impl import STATUS_LINE

from service.connections.connection import BoundedConnection
from service.connections.listener import Listener
from service.transport.draining import CLOSE
from service.transport.endpoints import Headers
from service.transport.fast_path import Shortcut, ShortcutRequest


class ShortcutConnection(BoundedConnection):
    """A bounded connection whose plain single pushes are answered by the shortcut.

    The shortcut has a request in two states: ``_opened`` while its body arrives, then ``_submitted`` until its answer.
    """

    shortcut: Shortcut

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]  # as uvicorn has it
        """Open the connection, without a request."""
        self._opened: ShortcutRequest | None = None
        self._is_timed = False
        self._is_ending = False
        super().connection_made(transport)

    def connection_lost(self, exc: Exception | None) -> None:
        """Pass an incomplete request to uvicorn, which logs that its client left."""
        self._hand_over()
        super().connection_lost(exc)

    def on_body(self, body: bytes) -> None:
        """Append a part of a body."""
        if self._opened is None:
            super().on_body(body)
        else:
            self._opened.body += body

    def on_message_complete(self) -> None:
        """Submit the request to the shortcut: it is complete."""
        request, self._opened = self._opened, None
        if request is None:
            super().on_message_complete()
        elif not self._is_ended:
            self._is_busy = True
            if self._is_timed:
                self._clock.pause()
            self.shortcut.answer(request, self._reply, lambda: self._leave(request.body))

    def shutdown(self) -> None:
        """Pass an incomplete request to uvicorn, then end as uvicorn does."""
        self._is_ending = True
        self._hand_over()
        super().shutdown()

    def _begin_request(self) -> None:
        """Open a request of the shortcut, or pass the head to uvicorn."""
        self._opened = self._open()
        if self._opened is None:
            super()._begin_request()

    def _open(self) -> ShortcutRequest | None:
        """Return the request of a complete head, or None if anything on this connection is unusual."""
        parser = self.parser
        if (
            self._is_ending
            or self._is_half_closed
            or self._chunks is not None
            or parser.get_method() != b"POST"
            or self.scope["http_version"] != "1.1"
            or not parser.should_keep_alive()
            or CLOSE in self.server_state.default_headers
        ):
            return None
        self.scope["method"] = "POST"
        return self.shortcut.open(self.url, cast(Scope, self.scope), self._fields, self._body_left)

    def _partial_bytes(self) -> int:
        """Count the whole body of an incomplete request, and give it the time of a body."""
        if self._opened is None:
            return super()._partial_bytes()
        if not self._is_timed:
            self._is_timed = True
            self._clock.begin()
        return self._body_left + len(self._opened.body)

    def _on_late(self) -> None:
        """Refuse a late body."""
        request, self._opened = self._opened, None
        if request is None:
            super()._on_late()
        else:
            self.shortcut.refuse_late(request, self._reply)

    def _reply(self, status: int, headers: Headers, content: bytes) -> None:
        """Write the answer of the shortcut, as uvicorn writes others."""
        if not (self._is_ended or self._bare.is_closing()):
            common = self.server_state.default_headers  # read once: a signal may add CLOSE to them at any time
            lines = b"\r\n".join([b": ".join(header) for header in (*common, *headers)])
            self._writes.write_whole(b"".join((STATUS_LINE[status], lines, b"\r\n\r\n", content)))
            if not self._is_busy or CLOSE in common:  # its body has not come, or the end has
                self._finish()
        self._is_timed = False
        self.on_response_complete()

    def _hand_over(self) -> None:
        """Pass an incomplete request to uvicorn."""
        request, self._opened = self._opened, None
        if request is not None and not self._is_ended:
            self._clock.pause()
            self._hold(0)
            self._is_timed = False
            super()._begin_request()
            if request.body:
                super().on_body(request.body)

    def _leave(self, body: bytes) -> None:
        """Pass a complete request to uvicorn."""
        self._is_timed = False
        super()._begin_request()
        super().on_body(body)
        super().on_message_complete()


def connection_class(listener: Listener, shortcut: Shortcut | None = None) -> type[BoundedConnection]:
    """Return the class of connections, which uvicorn instantiates itself.

    Args:
        listener: limits and counts that all connections share.
        shortcut: answers plain single pushes. None if every request must pass all rings.
    """
    own: dict[str, Any] = {"listener": listener}
    if shortcut is None:
        return type("Connection", (BoundedConnection,), own)
    return type("Connection", (ShortcutConnection,), {**own, "shortcut": shortcut})
