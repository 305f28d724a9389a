"""Tests of the deadline of a call and of the watch of its connection."""

import asyncio
import math
import socket
from typing import Any

import pytest

from service.client.deadline import ConnectionWatch, Deadline

SENDS = "http11.send_request_headers.started"


class FakeClock:
    """A clock that stands until it is moved."""

    def __init__(self) -> None:
        self.now_s = 0.0

    def __call__(self) -> float:
        """Return the time in s."""
        return self.now_s


class FakeStream:
    """A connection that takes a second for each read and write, and records their limits."""

    def __init__(self, clock: FakeClock) -> None:
        self._clock = clock
        self.waits: list[float | None] = []
        self.written = b""

    def read(self, max_bytes: int, timeout: float | None = None) -> bytes:
        """Return one byte after a second."""
        self.waits.append(timeout)
        self._clock.now_s += 1.0
        return b"x"

    def write(self, buffer: bytes, timeout: float | None = None) -> None:
        """Take bytes, which takes a second."""
        self.waits.append(timeout)
        self.written += buffer
        self._clock.now_s += 1.0


def opened(deadline: Deadline, stream: FakeStream) -> Any:
    """Let a watch see a connection that is opened."""
    watch = ConnectionWatch(deadline)
    watch.trace("connection.connect_tcp.started", {"host": "127.0.0.1", "port": 80, "timeout": 9.0})
    watch.trace("connection.connect_tcp.complete", {"return_value": stream})
    watch.trace(SENDS, {"request": None})
    assert not watch.was_idle
    return stream


def test_wait_is_bounded_by_the_deadline() -> None:
    """A wait takes its own limit, or the time that is left. Without time it does not begin."""
    clock = FakeClock()
    deadline = Deadline(2.0, clock)
    assert (deadline.bound_s(1.5), deadline.bound_s(5.0), deadline.bound_s(None)) == (1.5, 2.0, 2.0)
    clock.now_s = 2.0
    with pytest.raises(TimeoutError):
        deadline.bound_s(1.0)


def test_reads_end_at_the_deadline_although_each_gets_bytes() -> None:
    """A server that sends a byte now and then cannot stretch a call."""
    clock = FakeClock()
    deadline = Deadline(2.5, clock)
    stream = opened(deadline, FakeStream(clock))
    with ConnectionWatch(deadline):
        assert [stream.read(10, timeout=9.0) for _ in range(3)] == [b"x"] * 3
        with pytest.raises(TimeoutError):
            stream.read(10, timeout=9.0)
    assert stream.waits == [2.5, 1.5, 0.5]


def test_writes_end_at_the_deadline_although_each_sends_bytes() -> None:
    """A server that reads slowly cannot stretch a call: a large body is sent in pieces."""
    clock = FakeClock()
    deadline = Deadline(3.0, clock)
    stream = opened(deadline, FakeStream(clock))
    with ConnectionWatch(deadline), pytest.raises(TimeoutError):
        stream.write(bytes(1 << 20), timeout=9.0)
    assert stream.waits == [3.0, 2.0, 1.0]


def test_connection_has_the_deadline_of_the_call_that_uses_it() -> None:
    """A connection that stays open is bounded by each later call, and by none between calls."""
    clock = FakeClock()
    stream = opened(Deadline(1.0, clock), FakeStream(clock))
    with ConnectionWatch(Deadline(7.0, clock)):
        stream.read(10, timeout=9.0)
    stream.write(b"end", timeout=9.0)
    assert stream.waits == [7.0, 9.0]
    assert stream.written == b"end"


def test_steps_of_opening_share_the_deadline() -> None:
    """Connecting and the handshake get the time that is left when they begin."""
    clock = FakeClock()
    watch = ConnectionWatch(Deadline(5.0, clock))
    for event in ("connection.connect_tcp", "connection.start_tls"):
        info: dict[str, Any] = {"host": "127.0.0.1", "port": 80, "timeout": 9.0}
        watch.trace(f"{event}.started", info)
        assert info["timeout"] == 5.0 - clock.now_s
        clock.now_s += 2.0


def test_addresses_of_a_host_share_the_deadline(monkeypatch: pytest.MonkeyPatch) -> None:
    """A host of five addresses that do not answer takes no longer than one. An unknown host is left to the connect."""
    found: list[object] = [object()] * 5
    monkeypatch.setattr("socket.getaddrinfo", lambda *_, **__: found)
    watch = ConnectionWatch(Deadline(5.0, FakeClock()))
    for addresses, limit_s in ((5, 1.0), (1, 5.0), (0, 5.0)):
        found[:] = [object()] * addresses
        info: dict[str, Any] = {"host": "many.example", "port": 80, "timeout": 9.0}
        watch.trace("connection.connect_tcp.started", info)
        assert info["timeout"] == limit_s
    monkeypatch.undo()
    unknown: dict[str, Any] = {"host": "a..b", "port": 80, "timeout": 9.0}
    watch.trace("connection.connect_tcp.started", unknown)
    assert unknown["timeout"] == 5.0


def test_no_limit_is_one_that_a_socket_takes() -> None:
    """A deadline of infinity, or of many years, bounds each wait by a number that a socket takes."""
    for limit_s in (math.inf, 1e300):
        with socket.socket() as connection:
            connection.settimeout(Deadline(limit_s).bound_s(limit_s))


def test_request_on_an_idle_connection_is_known_until_its_answer() -> None:
    """A request without a new connection went to an idle one. Once its answer has begun, that no longer matters."""
    watch = ConnectionWatch(Deadline(5.0))
    seen = []
    for event in (SENDS, "http11.receive_response_headers.complete"):
        watch.trace(event, {"request": None})
        seen.append(watch.was_idle)
    assert seen == [True, False]


def test_watch_of_asyncio_knows_an_idle_connection_too() -> None:
    """The watch of asyncio tells a new connection from an idle one."""

    async def scenario() -> None:
        """Use an idle connection, then a new one."""
        idle, new = ConnectionWatch(Deadline(5.0)), ConnectionWatch(Deadline(5.0))
        await new.trace_async("connection.connect_tcp.started", {"timeout": 5.0})
        for watch in (idle, new):
            await watch.trace_async(SENDS, {"request": None})
        assert (idle.was_idle, new.was_idle) == (True, False)

    asyncio.run(scenario())
