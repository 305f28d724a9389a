"""A connection among others: it is counted, may be asked to make room, and ends without losing an answer."""

import asyncio
import socket
from http import HTTPStatus
from typing import Final, cast

from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol

from service.connections.framing import ChunkedBody
from service.connections.head_clock import HeadClock
from service.connections.listener import GatedFlow, Listener
from service.connections.unsent import PairedWrites
from service.errors import CazslError, MalformedRequestError, OverloadedError
from service.transport.callers import caller_at
from service.transport.problems import MEDIA_TYPE, problem_body

PROBE_S: Final = 0.25
_INTERIM: Final = b"HTTP/1.1 102 Processing\r\n\r\n"
LINGER_S: Final = 0.25  # by then a request has arrived that its client sent before it saw the end
KERNEL_BYTES: Final = 128 * 1024
MAX_DISCARDED_BYTES: Final = 1 << 30  # as large as a body may be by any setting


class ConnectionLifecycle(HttpToolsProtocol):
    """A connection of a listener, with the state of the request that it reads.

    A request is begun with the first byte of its head, in its body once the head is complete, and busy from its last
    byte to its answer.
    """

    listener: Listener

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]  # as uvicorn has it
        """Open the connection, and start its clock."""
        self._bare = transport
        self._writes = PairedWrites(transport, self.loop, self._finish)
        transport.set_write_buffer_limits(high=0)  # to write pauses as soon as bytes stay behind
        behind = transport.get_extra_info("socket")
        if behind is not None:  # the kernel would keep megabytes for each client that does not read
            behind.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, KERNEL_BYTES)
        super().connection_made(cast(asyncio.Transport, self._writes))
        self._gate = self.flow = GatedFlow(cast(asyncio.Transport, self._writes))
        self.caller = caller_at(self.client[0] if self.client else "")
        limits = self.listener.limits
        self._clock = HeadClock(self.loop, limits.head_s, limits.idle_s, self._on_late)
        self._is_begun = self._is_in_body = self._is_busy = self._is_ended = self._is_half_closed = False
        self._before = b""  # last bytes of an incomplete head
        self._rest = b""  # bytes behind the request that is being answered
        self._fields: dict[bytes, bytes] = {}  # headers by name, the last of each
        self._body_left = 0
        self._chunks: ChunkedBody | None = None
        self._held_bytes = 0
        self._discarded_bytes = 0
        self._lingering: asyncio.TimerHandle | None = None
        self.listener.open.enter(self)

    def connection_lost(self, exc: Exception | None) -> None:
        """Stop the clock, and release everything that is held."""
        self._is_ended = True
        self._clock.close()
        if self._lingering is not None:
            self._lingering.cancel()
        self._rest = b""
        self._hold(0)
        self.listener.open.leave(self)
        self.listener.unsent.remove(self)
        super().connection_lost(exc)

    def pause_writing(self) -> None:
        """Watch the answers that have not left."""
        super().pause_writing()
        self.listener.unsent.add(self)

    # ``OpenConnections`` and ``UnsentAnswers`` call these.

    def is_idle(self) -> bool:
        """Return True if no request is on its way."""
        return self._is_ended or not (self._is_begun or self._rest or self.flow.write_paused)

    def is_busy(self) -> bool:
        """Return True if the service works on a request."""
        return self._is_busy and not self._is_ended

    def waited_s(self) -> float:
        """Return the time for which the connection has waited for its client, in s."""
        return self._clock.waited_s()

    def make_room(self) -> None:
        """End the connection at once, for another one."""
        if self.is_idle() and not self._is_ended:
            self._finish()
        else:
            self.cut_off("connections")

    def turn_away(self) -> None:
        """Refuse the connection: there are too many."""
        error = OverloadedError(f"{self.listener.limits.connections} connections")
        self._refuse(error.status, error.code, str(error), linger=False)

    def unsent_bytes(self) -> int:
        """Return the number of bytes that the client has not taken."""
        return int(self.transport.get_write_buffer_size())

    def cut_off(self, reason: str) -> None:
        """End the connection at once, and count why."""
        self.listener.refuse(reason)
        self._is_ended = True
        self.transport.abort()

    def shutdown(self) -> None:
        """Answer a request that is on its way on this open connection, as the last one, then close."""
        if self.cycle is None or self.cycle.response_complete:
            self.loop.call_later(LINGER_S, self._end_unless_busy)
        else:
            super().shutdown()

    def _end_unless_busy(self) -> None:
        if self._is_busy or self._is_in_body:
            super().shutdown()
        elif not self._is_ended:
            self._is_ended = True
            self._writes.end()

    def _hold(self, count: int) -> None:
        """Hold this number of bytes of requests that the application does not know yet."""
        change, self._held_bytes = count - self._held_bytes, count
        if change < 0:
            self.listener.held.give(self.caller, -change)
        elif change:
            try:
                self.listener.held.take(self.caller, change)
            except CazslError as error:
                self._held_bytes -= change
                self._refuse(error.status, error.code, str(error))

    def _refuse_malformed(self, detail: str) -> None:
        self._refuse(MalformedRequestError.status, MalformedRequestError.code, detail)

    def _refuse_large_head(self, things: str, limit: int) -> None:
        detail = f"head: received more than {limit} {things}; accepted are up to {limit}"
        self._refuse(HTTPStatus.REQUEST_HEADER_FIELDS_TOO_LARGE, "head_too_large", detail)

    def _refuse(self, status: HTTPStatus, code: str, detail: str, *, linger: bool = True) -> None:
        """Write a problem and end. The application has no request that it could answer."""
        if self._is_ended or self.transport.is_closing():
            return
        request_id = self.listener.refuse(code)
        body = problem_body(status, code, status.phrase, detail, request_id=request_id)
        retry = "retry-after: 1\r\n" if status == HTTPStatus.SERVICE_UNAVAILABLE else ""
        head = (
            f"HTTP/1.1 {status.value} {status.phrase}\r\ncontent-type: {MEDIA_TYPE}\r\ncontent-length: {len(body)}\r\n"
            f"{retry}x-request-id: {request_id}\r\nconnection: close\r\n\r\n"
        )
        self._writes.write_whole(head.encode("ascii") + body)
        self._finish(linger=linger)
        if self.cycle is not None and not self.cycle.response_complete:  # its application would answer a second time
            self.cycle.disconnected = True
            self.cycle.message_event.set()

    def _finish(self, *, linger: bool = False) -> None:
        """End the connection behind the last answer.

        A client that is still sending would not see its answer if the connection closed under it. So the sending half
        is closed first, and what comes is discarded, within bounds.
        """
        if self._is_ended:
            return
        is_sending = linger or (self._is_begun and not self._is_busy) or bool(self._rest)
        self._is_ended = True
        self._clock.pause()
        self._rest = b""
        self._hold(0)
        if not is_sending or self._is_half_closed:
            self._writes.end()
            return
        self._writes.end_sending()
        self._gate.is_shut = False
        self.flow.resume_reading()
        self._lingering = self.loop.call_later(self.listener.limits.head_s, self._writes.end)

    def _on_late(self) -> None:
        """Refuse a head that is late. Close an idle connection without a word."""
        if self._is_ended or self._clock.is_idle:
            self._finish()
            return
        head_s = self.listener.limits.head_s
        detail = f"head: received only a part within {head_s:g} s; accepted is all of it within {head_s:g} s"
        self._refuse(HTTPStatus.REQUEST_TIMEOUT, "slow_head", detail)

    def _probe(self, after_s: float = PROBE_S) -> None:
        """Find out whether a client that sends no more has left, if its answer takes long.

        A client that shut only its sending half ignores interim responses. Those to one that has left come back, which
        ends the connection, and with it the work for the answer.
        """
        if self.scope["http_version"] == "1.1":
            self.loop.call_later(after_s, self._on_probe, after_s)

    def _on_probe(self, after_s: float) -> None:
        is_answered = self.cycle is None or self.cycle.response_started
        if not self._is_ended and self._is_busy and not is_answered:
            self._bare.write(_INTERIM)
            self._probe(2.0 * after_s)

    def _set_aside(self, data: bytes) -> None:
        """Keep bytes for later, or discard them if the connection ends."""
        if self._is_ended:
            self._discarded_bytes += len(data)
            if self._discarded_bytes > MAX_DISCARDED_BYTES:
                self._writes.end()
            return
        self._rest += data
        self.flow.pause_reading()
        self._gate.is_shut = True
        self._hold(len(self._rest))

    def _end_of_requests(self) -> bool:
        """End after the last byte of the client. Return False if the connection is to close without an answer."""
        if self._is_begun:
            part = "body" if self._is_in_body else "head"
            self._refuse_malformed(f"{part}: received only a part before the end; accepted is all of it")
            return True
        return self.flow.write_paused
