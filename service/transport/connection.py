"""A connection of uvicorn's, bounded where uvicorn is patient: the head of a request, in time and in bytes.

Without these bounds a client holds a connection for ever by sending its headers slowly, or memory by sending them
without end. What cannot be read as HTTP is answered as a problem, like every other failure.

Head and body of an answer leave in one write. Between two, a ``kill -9`` would leave a client, or a proxy that could
still have asked another instance, with half an answer.

A plain request for one push takes the short way, unless something on the connection is unusual. Until its body is whole
it may still be handed over to the long way, as uvicorn goes it, as if it had just come.
"""

import asyncio
from collections.abc import Callable
from http import HTTPStatus
from typing import Any, Final, cast

from starlette.types import Scope
from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol

from service.transport.fast_path import Headers
from service.transport.problems import MEDIA_TYPE, problem_body
from service.transport.short_way import ShortRequest, ShortWay

LEAVE: Final = (b"connection", b"close")  # among the headers of every answer, once the service is to end
MAX_HEAD_BYTES: Final = 64 * 1024
LINGER_S: Final = 0.25  # a request that was sent before its client saw the end is here by then


class PairedWrites:
    """A transport that holds what is written until it can leave with what is written next, or nothing is."""

    def __init__(self, transport: asyncio.Transport, loop: asyncio.AbstractEventLoop) -> None:
        self._transport = transport
        self._loop = loop
        self._held = b""

    def __getattr__(self, name: str) -> Any:
        return getattr(self._transport, name)

    def write(self, data: bytes) -> None:
        """Send with what is held, or hold until whoever writes now has written."""
        if self._held:
            held, self._held = self._held, b""
            self._transport.writelines((held, data))
        else:
            self._held = data
            self._loop.call_soon(self._send_held)

    def write_whole(self, data: bytes) -> None:
        """Send a whole answer, after what is held."""
        self._send_held()
        self._transport.write(data)

    def close(self) -> None:
        """Send what is held, and close."""
        self._send_held()
        self._transport.close()

    def _send_held(self) -> None:
        held, self._held = self._held, b""
        if held and not self._transport.is_closing():
            self._transport.write(held)


class BoundedConnection(HttpToolsProtocol):
    """HTTP/1.1 whose heads arrive in time and are of bounded size."""

    head_s = 10.0
    refused: Callable[[str], None] = staticmethod(lambda code: None)
    short_way: ShortWay | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]  # as uvicorn has it
        """Begin to look at the clock."""
        self._writes = PairedWrites(transport, self.loop)
        super().connection_made(cast(asyncio.Transport, self._writes))
        self._short: ShortRequest | None = None  # whose body is not whole yet
        self._asked = False  # a short request has no answer yet
        self._in_line = True  # the client waits for an answer before it asks again, and the service is not to end
        self._head_bytes = 0
        self._waits_since: float | None = self.loop.time()  # for the end of a head; None while a request is answered
        self._look_later(self.head_s)

    def connection_lost(self, exc: Exception | None) -> None:
        """Stop looking: the clock would hold the connection in memory for as long as a head may take."""
        self._looking.cancel()
        self._hand_over()  # which tells the log that somebody has left
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """Read, and count what is read of a head."""
        super().data_received(data)
        if self._waits_since is None or self._short is not None:
            return
        self._head_bytes += len(data)
        if self._head_bytes > MAX_HEAD_BYTES:
            self._refuse(
                HTTPStatus.REQUEST_HEADER_FIELDS_TOO_LARGE,
                "head_too_large",
                f"head: received more than {MAX_HEAD_BYTES} bytes of request line and headers; accepted is less",
            )

    def on_message_begin(self) -> None:
        """A head begins."""
        if self._asked and self.short_way is not None:
            self._in_line = False  # it could hold the loop with as many as it sends in one go
            self.short_way.end_turn()
        super().on_message_begin()
        self._head_bytes = 0
        if self._waits_since is None:
            self._waits_since = self.loop.time()

    def on_headers_complete(self) -> None:
        """The head is whole."""
        self._short = self._open_short()
        if self._short is None:
            self._waits_since = None
            super().on_headers_complete()

    def on_body(self, body: bytes) -> None:
        """A part of a body."""
        if self._short is not None:
            self._short.body += body
            return
        cycle: Any = self.cycle  # which would copy each piece twice
        if not cycle.body:
            cycle.body = b""  # which and a piece are that piece
        elif isinstance(cycle.body, bytes):
            cycle.body = bytearray(cycle.body)  # to which many pieces can be added
        super().on_body(body)

    def on_message_complete(self) -> None:
        """The request is whole."""
        request, self._short = self._short, None
        if request is None or self.short_way is None:
            super().on_message_complete()
            return
        self._waits_since = None
        self._asked = True
        self.short_way.answer(request, self._reply, lambda: self._leave(bytes(request.body)))

    def _open_short(self) -> ShortRequest | None:
        """The request whose head has come, where nothing on this connection is unusual."""
        parser = self.parser
        if (
            self.short_way is None
            or not self._in_line
            or parser.get_method() != b"POST"
            or parser.get_http_version() != "1.1"
            or not parser.should_keep_alive()
            or parser.should_upgrade()
            or self.expect_100_continue
            or self.flow.write_paused
            or not (self.cycle is None or self.cycle.response_complete)
            or LEAVE in self.server_state.default_headers
        ):
            return None
        self.scope["method"] = "POST"
        return self.short_way.open(self.url, cast(Scope, self.scope))

    def _reply(self, headers: Headers, content: bytes) -> None:
        """Write the answer of a short request, as uvicorn writes others."""
        self._asked = False
        if not self.transport.is_closing():
            lines = [b"%b: %b\r\n" % header for header in (*self.server_state.default_headers, *headers)]
            self._writes.write_whole(b"".join((b"HTTP/1.1 200 OK\r\n", *lines, b"\r\n", content)))
        self.on_response_complete()

    def _hand_over(self) -> None:
        """Let a request whose body is not whole yet take the long way."""
        request, self._short = self._short, None
        if request is None:
            return
        self._waits_since = None
        super().on_headers_complete()
        super().on_body(bytes(request.body))

    def _leave(self, body: bytes) -> None:
        """Let a whole request take the long way."""
        self._asked = False
        if self not in self.connections:  # the client has gone
            return
        super().on_headers_complete()
        super().on_body(body)
        super().on_message_complete()

    def on_response_complete(self) -> None:
        """The next head is waited for; until its first byte uvicorn's own keep-alive bounds that."""
        self._head_bytes = 0
        self._waits_since = self.loop.time()
        super().on_response_complete()

    def shutdown(self) -> None:
        """The doors are closed; what is on its way on an open connection is still answered, as the last on it."""
        self._in_line = False
        self._hand_over()
        if self.cycle is None or self.cycle.response_complete:
            self.loop.call_later(LINGER_S, super().shutdown)
        else:
            super().shutdown()

    def send_400_response(self, msg: str) -> None:
        """Answer what is no HTTP."""
        self._refuse(HTTPStatus.BAD_REQUEST, "malformed_request", "received what is no HTTP/1.1; accepted is that")

    def _look(self) -> None:
        """End the connection when its head is late; look again later otherwise."""
        if self.transport.is_closing():
            return
        left = self.head_s if self._waits_since is None else self._waits_since + self.head_s - self.loop.time()
        if left > 0.0:
            self._look_later(left)
            return
        if self._short is not None:  # its body is late, which the long way bounds
            self._hand_over()
            self._look_later(self.head_s)
            return
        detail = f"head: received a part of it in {self.head_s:g} s; accepted is all of it in {self.head_s:g} s"
        self._refuse(HTTPStatus.REQUEST_TIMEOUT, "slow_head", detail)

    def _look_later(self, left_s: float) -> None:
        self._looking = self.loop.call_later(left_s + 0.01, self._look)

    def _refuse(self, status: HTTPStatus, code: str, detail: str) -> None:
        """Write a problem and close: there is no request yet that an application could answer."""
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


def bounded_connection(head_s: float, refused: Callable[[str], None], short_way: ShortWay | None = None) -> type[Any]:
    """The class of connections whose heads may take so long, and who is told of refusals; uvicorn makes them itself.

    ``short_way`` answers plain requests for single pushes, where there is one.
    """
    own = {"head_s": head_s, "refused": staticmethod(refused), "short_way": short_way}
    return type("Connection", (BoundedConnection,), own)
