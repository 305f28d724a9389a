"""Connections of uvicorn that read one request at a time, and that end without losing an answer.

``BoundedConnection`` bounds a request before it reaches the application, and answers bytes that are not HTTP with a
problem. The bytes behind a request wait until it is answered, so answers and refusals leave in order. An offered
upgrade is ignored, and trailers are never headers.

Head and body of an answer leave in one write. Between two writes, a ``kill -9`` would leave half an answer with a
client, or with a proxy that could still have asked another instance.
"""

import asyncio
import logging
import urllib.parse
from http import HTTPStatus
from typing import Any, Final, cast

import httptools
from uvicorn.protocols.http.flow_control import HIGH_WATER_LIMIT

from service.connections.framing import (
    MAX_HEADERS,
    MAX_TARGET_BYTES,
    ChunkedBody,
    end_of_head,
    expects_100,
    head_without_upgrade,
    path_and_query,
    straddling,
)
from service.connections.head_clock import MAX_HEAD_BYTES
from service.connections.lifecycle import ConnectionLifecycle
from service.connections.listener import Cycle
from service.errors import MalformedRequestError

CHUNKS_AT_ONCE: Final = 8 * 1024  # bytes of chunks in one turn: tiny ones cost 3 us each
_LINE_ENDS: Final = b"\r\n"

logger = logging.getLogger(__name__)


class BoundedConnection(ConnectionLifecycle):
    """A connection of HTTP/1.1 that bounds its requests in time and in bytes."""

    def data_received(self, data: bytes) -> None:
        """Read bytes, or set them aside while a request is being answered."""
        if self._rest or self._is_busy or self._is_ended or self.flow.write_paused:
            self._set_aside(data)
        else:
            self._read(data)

    def eof_received(self) -> bool:  # type: ignore[override]  # uvicorn never keeps the other half open
        """Answer the requests that have come before the client shut its sending half, then close."""
        self._is_half_closed = True
        stays = not self._is_ended and (self._is_busy or bool(self._rest) or self._end_of_requests())
        if not stays:
            self._writes.end()  # the transport would close before the bytes that are held
        elif self._is_busy:
            self._probe()
        return stays

    def resume_writing(self) -> None:
        """Read on: all answers have left."""
        super().resume_writing()
        self.listener.unsent.remove(self)
        self._go_on()

    # The parser calls these.

    def on_message_begin(self) -> None:
        """Begin a head."""
        super().on_message_begin()
        self._is_begun = True
        self._clock.begin()

    def on_header(self, name: bytes, value: bytes) -> None:
        """Keep a header, and one more than are accepted."""
        if len(self.headers) <= MAX_HEADERS:
            self.headers.append((name.lower(), value.rstrip(b" \t")))  # llhttp leaves spaces at the end

    def on_headers_complete(self) -> None:
        """Begin a request: its head is complete. One that offers an upgrade is read again without the offer."""
        if len(self.headers) > MAX_HEADERS:
            self._refuse_large_head("headers", MAX_HEADERS)
        if self._is_ended or (self.parser.should_upgrade() and self.parser.get_method() != b"CONNECT"):
            return
        self._clock.pause()
        self._is_in_body = True
        version = self.parser.get_http_version()
        self.scope["http_version"] = version
        fields = self._fields = dict(self.headers)
        coding = fields.get(b"transfer-encoding")
        self._body_left = int(fields.get(b"content-length") or b"0")
        self._chunks = None
        if len(self.url) > MAX_TARGET_BYTES:
            self._refuse_large_head("bytes of the target", MAX_TARGET_BYTES)
        elif version not in ("1.1", "1.0"):
            self._refuse(
                HTTPStatus.HTTP_VERSION_NOT_SUPPORTED,
                "malformed_request",
                "received another version of HTTP; accepted is HTTP/1.1",
            )
        elif coding is not None:
            is_alone = sum(name == b"transfer-encoding" for name, _ in self.headers) == 1
            if not is_alone or coding.strip().lower() != b"chunked" or version == "1.0":
                self._refuse_malformed("header Transfer-Encoding: received another coding; accepted is chunked")
            else:
                self._chunks = ChunkedBody()
        if not self._is_ended:
            self._begin_request()

    def on_body(self, body: bytes) -> None:
        """Append a part of a body, without the two copies that uvicorn makes of each."""
        cycle: Any = self.cycle
        if self._is_ended or cycle.response_complete:
            return
        if not cycle.body:
            cycle.body = body
        elif isinstance(cycle.body, bytes):
            cycle.body = bytearray(cycle.body) + body  # grows with each part
        else:
            cycle.body += body
        if len(cycle.body) > HIGH_WATER_LIMIT:
            self.flow.pause_reading()
        cycle.message_event.set()

    def on_message_complete(self) -> None:
        """End a request: its body is complete."""
        if self._is_in_body and not self._is_ended:
            self._is_busy = True
            self.cycle.more_body = False
            self.cycle.message_event.set()

    def on_response_complete(self) -> None:
        """Go on with the next request, in another iteration: a client that sends many must not hold the event loop."""
        self.server_state.total_requests += 1
        self._is_begun = self._is_in_body = self._is_busy = False
        if self._is_ended or self._bare.is_closing():
            return
        self._clock.rest()
        if self._rest or self._is_half_closed:
            self.loop.call_soon(self._go_on)
        elif self.flow.read_paused:
            self.flow.resume_reading()

    def send_400_response(self, msg: str) -> None:
        """Answer bytes that are not HTTP with a problem."""
        self._refuse_malformed("the request is not valid HTTP/1.1")

    # Reading.

    def _read(self, data: bytes) -> None:
        """Read bytes up to the end of a request, and set the others aside."""
        has_read_chunks = False
        while data and not (self._is_busy or self._is_ended or has_read_chunks):
            if not self._is_in_body:
                data = self._read_head(data)
            elif self._chunks is None:
                data = self._read_body(data)
            else:
                data, has_read_chunks = self._read_chunks(data[:CHUNKS_AT_ONCE]) + data[CHUNKS_AT_ONCE:], True
        if self._is_ended:
            return
        if data:
            self._set_aside(data)
            if not self._is_busy:
                self.loop.call_soon(self._go_on)  # other connections have their turn between many chunks
        elif not self._is_busy:
            self._hold(self._partial_bytes())
        elif self._held_bytes:
            self._hold(0)

    def _read_head(self, data: bytes) -> bytes:
        """Read bytes of a head. Return those behind it."""
        if not self._is_begun and data[0] in _LINE_ENDS:  # empty lines before a request are allowed
            rest = data.lstrip(_LINE_ENDS)
            part, end = data[: len(data) - len(rest)], len(data) - len(rest)
        else:
            end = end_of_head(self._before, data)
            part = data if end < 0 else data[:end]
            self._before = straddling(self._before, data) if end < 0 else b""
        if self._clock.add(len(part)):
            self._refuse_large_head("bytes of request line and headers", MAX_HEAD_BYTES)
        else:
            self._feed(part)
        return data[len(part) :]

    def _read_body(self, data: bytes) -> bytes:
        """Read bytes of a body of known length. Return those behind it."""
        end = min(self._body_left, len(data))
        self._body_left -= end
        self._feed(data[:end])
        self._check_end(is_whole=not self._body_left)
        return data[end:]

    def _read_chunks(self, data: bytes) -> bytes:
        """Read bytes of a chunked body. Return those behind it. The parser gets an empty line for the trailers."""
        walker = cast(ChunkedBody, self._chunks)
        try:
            chunks, end = walker.walk(data)
        except MalformedRequestError as error:
            self._refuse_malformed(str(error))
            return b""
        self._feed(data[:chunks])
        if end < 0:
            self._check_end(is_whole=False)
            return b""
        if not self._is_ended:
            self._feed(_LINE_ENDS)
        self._check_end(is_whole=True)
        return data[end:]

    def _check_end(self, *, is_whole: bool) -> None:
        """Refuse a body whose end the parser finds elsewhere."""
        if is_whole is not self._is_busy and not self._is_ended:
            self._refuse_malformed("the body is not valid HTTP/1.1")

    def _feed(self, data: bytes) -> None:
        """Pass bytes of one request to the parser."""
        try:
            self.parser.feed_data(data)
        except httptools.HttpParserUpgrade:
            if not self._is_ended:
                self._read_again_without_upgrade()
        except httptools.HttpParserCallbackError:
            if not self._is_ended:
                logger.exception("connection failed")
                phrase = HTTPStatus.INTERNAL_SERVER_ERROR.phrase
                self._refuse(HTTPStatus.INTERNAL_SERVER_ERROR, "internal", phrase)
        except httptools.HttpParserError:
            self.send_400_response("")

    def _read_again_without_upgrade(self) -> None:
        """Read a complete head again, without its offer of another protocol. llhttp leaves its body unread."""
        parser, self.parser = self.parser, httptools.HttpRequestParser(self)
        self._feed(head_without_upgrade(parser.get_method(), self.url, parser.get_http_version(), self.headers))

    def _begin_request(self) -> None:
        """Pass the request to the application, which reads its body."""
        target = path_and_query(self.url)
        if target is None or self.parser.get_method() == b"CONNECT":
            self._refuse_malformed("target: received one that is no path; accepted is a path, or a URL of this service")
            return
        raw_path, query = target
        path = raw_path.decode("ascii")
        scope: Any = self.scope
        scope["method"] = self.parser.get_method().decode("ascii")
        scope["path"] = self.root_path + (urllib.parse.unquote(path) if "%" in path else path)
        scope["raw_path"] = self.root_path.encode("ascii") + raw_path
        scope["query_string"] = query
        is_current = scope["http_version"] == "1.1"
        self.cycle = Cycle(
            scope=scope,
            transport=self.transport,
            flow=self.flow,
            logger=self.logger,
            access_logger=self.access_logger,
            access_log=self.access_log,
            default_headers=self.server_state.default_headers,
            message_event=asyncio.Event(),
            expect_100_continue=is_current and self._has_body() and expects_100(self.headers),
            keep_alive=is_current and self.parser.should_keep_alive(),
            on_response=self.on_response_complete,
        )
        self.cycle.server_state = self.server_state
        self._start_asgi_task(self.cycle, self.app)

    def _has_body(self) -> bool:
        return self._body_left > 0 or self._chunks is not None

    def _partial_bytes(self) -> int:
        """Return the bytes of an incomplete request that no other part counts."""
        return self._clock.count

    def _go_on(self) -> None:
        """Read the bytes that were set aside, once the last answer has left."""
        if self._is_busy or self._is_ended or self.flow.write_paused:
            return
        rest, self._rest = self._rest, b""
        self._gate.is_shut = False
        self._read(rest)
        self._await_more()

    def _await_more(self) -> None:
        """Receive the next bytes, unless a request is being answered, or the client sends no more."""
        if self._is_ended or self._is_busy:
            return
        if not self._is_half_closed:
            self.flow.resume_reading()
        elif not self._rest and not self._end_of_requests():
            self._writes.end()
