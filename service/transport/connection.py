"""Connections of uvicorn with bounds that uvicorn lacks, and with the shortcut for single pushes.

``BoundedConnection`` bounds the head of a request, and answers bytes that are not HTTP with a problem.
``ShortcutConnection`` adds the shortcut: a plain single push is answered without ASGI. If anything on the connection is
unusual, the request is passed to uvicorn unchanged. That is possible until its body is complete.

Head and body of an answer leave in one write. Between two writes, a ``kill -9`` would leave half an answer with a
client, or with a proxy that could still have asked another instance.
"""

import asyncio
from collections.abc import Callable
from http import HTTPStatus
from typing import Any, Final, cast

from starlette.types import Scope
from uvicorn.protocols.http.httptools_impl import STATUS_LINE, HttpToolsProtocol

from service.transport.endpoints import Headers
from service.transport.fast_path import Shortcut, ShortcutRequest
from service.transport.head_clock import MAX_HEAD_BYTES, HeadClock
from service.transport.problems import MEDIA_TYPE, problem_body

CLOSE: Final = (b"connection", b"close")  # among the headers of every answer once the service is to end
LINGER_S: Final = 0.25  # by then a request has arrived that its client sent before it saw the end


class PairedWrites:
    """A transport that joins two writes: it holds the first until the second, or until the end of the iteration."""

    def __init__(self, transport: asyncio.Transport, loop: asyncio.AbstractEventLoop) -> None:
        self._transport = transport
        self._loop = loop
        self._held = b""

    def __getattr__(self, name: str) -> Any:
        return getattr(self._transport, name)

    def write(self, data: bytes) -> None:
        """Send together with the held bytes, or hold these until the next write."""
        if self._held:
            held, self._held = self._held, b""
            self._transport.writelines((held, data))
        else:
            self._held = data
            self._loop.call_soon(self._send_held)

    def write_whole(self, data: bytes) -> None:
        """Send a complete answer, after the held bytes."""
        self._send_held()
        self._transport.write(data)

    def close(self) -> None:
        """Send the held bytes, then close."""
        self._send_held()
        self._transport.close()

    def _send_held(self) -> None:
        held, self._held = self._held, b""
        if held and not self._transport.is_closing():
            self._transport.write(held)


class BoundedConnection(HttpToolsProtocol):
    """A connection of HTTP/1.1 that bounds the heads of requests in time and in bytes."""

    head_s = 10.0
    refused: Callable[[str], None] = staticmethod(lambda code: None)

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]  # as uvicorn has it
        """Start the clock of heads."""
        self._writes = PairedWrites(transport, self.loop)
        super().connection_made(cast(asyncio.Transport, self._writes))
        self._clock = HeadClock(self.loop, self.head_s, self._on_late)

    def connection_lost(self, exc: Exception | None) -> None:
        """Stop the clock."""
        self._clock.close()
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """Read bytes, and count those of a head."""
        super().data_received(data)
        if self._awaits_head() and self._clock.add(len(data)):
            self._refuse(
                HTTPStatus.REQUEST_HEADER_FIELDS_TOO_LARGE,
                "head_too_large",
                f"head: received more than {MAX_HEAD_BYTES} bytes of request line and headers; "
                f"accepted is up to {MAX_HEAD_BYTES} bytes",
            )

    def on_message_begin(self) -> None:
        """Begin a head."""
        super().on_message_begin()
        self._clock.begin()

    def on_headers_complete(self) -> None:
        """Pause the clock: the head is complete."""
        self._clock.pause()
        super().on_headers_complete()

    def on_body(self, body: bytes) -> None:
        """Append a part of a body, without the two copies that uvicorn makes of each."""
        cycle: Any = self.cycle
        if not cycle.body:
            cycle.body = b""  # to append a part to it makes no copy
        elif isinstance(cycle.body, bytes):
            cycle.body = bytearray(cycle.body)  # grows with each part
        super().on_body(body)

    def on_response_complete(self) -> None:
        """Await the next head. Until its first byte, the keep-alive timer of uvicorn bounds the connection too."""
        self._clock.restart()
        super().on_response_complete()

    def shutdown(self) -> None:
        """Answer a request that is on its way on this open connection, as the last one, then close."""
        if self.cycle is None or self.cycle.response_complete:
            self.loop.call_later(LINGER_S, super().shutdown)
        else:
            super().shutdown()

    def send_400_response(self, msg: str) -> None:
        """Answer bytes that are not HTTP with a problem."""
        self._refuse(HTTPStatus.BAD_REQUEST, "malformed_request", "the request is not valid HTTP/1.1")

    def _awaits_head(self) -> bool:
        return True

    def _on_late(self) -> None:
        """Refuse a head that is late, and close."""
        detail = f"head: received only a part within {self.head_s:g} s; accepted is all of it within {self.head_s:g} s"
        self._refuse(HTTPStatus.REQUEST_TIMEOUT, "slow_head", detail)

    def _refuse(self, status: HTTPStatus, code: str, detail: str) -> None:
        """Write a problem and close. The application has no request yet that it could answer."""
        if self.transport.is_closing():
            return
        self.refused(code)
        body = problem_body(status, code, status.phrase, detail)
        head = (
            f"HTTP/1.1 {status.value} {status.phrase}\r\ncontent-type: {MEDIA_TYPE}\r\n"
            f"content-length: {len(body)}\r\nconnection: close\r\n\r\n"
        )
        self.transport.write(head.encode("ascii") + body)
        self.transport.close()


class ShortcutConnection(BoundedConnection):
    """A bounded connection whose plain single pushes are answered by the shortcut.

    The shortcut has a request in two states: ``_opened`` while its body arrives, then ``_submitted`` until its answer.
    """

    shortcut: Shortcut

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]  # as uvicorn has it
        """Open the connection, without a request."""
        self._opened: ShortcutRequest | None = None
        self._submitted = False
        self._in_turn = True  # the client awaits each answer before its next request, and the service is not ending
        super().connection_made(transport)

    def connection_lost(self, exc: Exception | None) -> None:
        """Pass an incomplete request to uvicorn, which logs that its client left."""
        self._hand_over()
        super().connection_lost(exc)

    def on_message_begin(self) -> None:
        """Begin a head. A client that does not await its answers loses the shortcut: it could hold the event loop."""
        if self._submitted:
            self._in_turn = False
            self.shortcut.flush()
            self._unset_keepalive_if_required()  # that answer started the timer, and the connection is not idle
        super().on_message_begin()

    def on_headers_complete(self) -> None:
        """Open a request of the shortcut, or pass the head to uvicorn."""
        self._opened = self._open()
        if self._opened is None:
            super().on_headers_complete()

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
            return
        self._clock.pause()
        self._submitted = True
        self.shortcut.answer(request, self._reply, lambda: self._leave(bytes(request.body)))

    def shutdown(self) -> None:
        """Pass an incomplete request to uvicorn, then end as uvicorn does."""
        self._in_turn = False
        self._hand_over()
        super().shutdown()

    def _awaits_head(self) -> bool:
        return self._opened is None

    def _on_late(self) -> None:
        """Pass a request with a late body to uvicorn: admission bounds bodies."""
        if self._opened is not None:
            self._hand_over()
        else:
            super()._on_late()

    def _open(self) -> ShortcutRequest | None:
        """Return the request of a complete head, or None if anything on this connection is unusual."""
        parser = self.parser
        if (
            not self._in_turn
            or parser.get_method() != b"POST"
            or parser.get_http_version() != "1.1"
            or not parser.should_keep_alive()
            or parser.should_upgrade()
            or self.expect_100_continue
            or self.flow.write_paused
            or not (self.cycle is None or self.cycle.response_complete)
            or CLOSE in self.server_state.default_headers
        ):
            return None
        self.scope["method"] = "POST"
        return self.shortcut.open(self.url, cast(Scope, self.scope))

    def _reply(self, status: int, headers: Headers, content: bytes) -> None:
        """Write the answer of the shortcut, as uvicorn writes others."""
        self._submitted = False
        if not self.transport.is_closing():
            lines = b"\r\n".join([b": ".join(header) for header in (*self.server_state.default_headers, *headers)])
            self._writes.write_whole(b"".join((STATUS_LINE[status], lines, b"\r\n\r\n", content)))
        self.on_response_complete()

    def _hand_over(self) -> None:
        """Pass an incomplete request to uvicorn."""
        request, self._opened = self._opened, None
        if request is not None:
            super().on_headers_complete()
            super().on_body(bytes(request.body))

    def _leave(self, body: bytes) -> None:
        """Pass a complete request to uvicorn."""
        self._submitted = False
        super().on_headers_complete()
        super().on_body(body)
        super().on_message_complete()


def connection_class(
    head_s: float, refused: Callable[[str], None], shortcut: Shortcut | None = None
) -> type[BoundedConnection]:
    """Return the class of connections, which uvicorn instantiates itself.

    Args:
        head_s: longest time until a head is complete, in s.
        refused: called with the code of each refusal that happens before there is a request.
        shortcut: answers plain single pushes. None if every request must pass all rings.
    """
    own: dict[str, Any] = {"head_s": head_s, "refused": staticmethod(refused)}
    if shortcut is None:
        return type("Connection", (BoundedConnection,), own)
    return type("Connection", (ShortcutConnection,), {**own, "shortcut": shortcut})
