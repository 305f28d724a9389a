"""Connections join head and body in one write. tests/test_attacks.py tests the bounds on heads with raw sockets."""

import asyncio
import gc
import weakref
from collections.abc import Callable

import pytest
from starlette.responses import PlainTextResponse
from starlette.types import Receive, Scope, Send

from service.transport.connection import PairedWrites
from tests.fake_connection import FakeConnection, FakeTransport


def sent_by(write: Callable[[PairedWrites], None]) -> list[bytes]:
    """Return the bytes of each system call for writes in one iteration."""

    async def run() -> list[bytes]:
        """Write in an event loop."""
        transport = FakeTransport()
        write(PairedWrites(transport, asyncio.get_running_loop()))
        await asyncio.sleep(0)
        return transport.sent

    return asyncio.run(run())


@pytest.mark.parametrize(
    ("pieces", "calls"),
    [
        ((b"head", b"body"), [b"headbody"]),
        ((b"head",), [b"head"]),
        ((b"head", b""), [b"head"]),
        ((b"head", b"body", b"head", b"body"), [b"headbody", b"headbody"]),
        ((b"head", b"part", b"part"), [b"headpart", b"part"]),
        ((b"", b"body"), [b"body"]),
    ],
    ids=["an answer", "a head alone", "an empty body", "two answers", "a body in parts", "an empty head"],
)
def test_writes_of_an_iteration_are_sent_in_pairs(pieces: tuple[bytes, ...], calls: list[bytes]) -> None:
    """Head and body are sent in one call, and no bytes are held beyond the iteration."""

    def write(transport: PairedWrites) -> None:
        for piece in pieces:
            transport.write(piece)

    assert sent_by(write) == calls


def test_closing_sends_the_held_bytes() -> None:
    """A refusal that is written just before the connection closes is sent first."""

    def write(transport: PairedWrites) -> None:
        transport.write(b"refused")
        transport.close()
        assert transport.is_closing()

    assert sent_by(write) == [b"refused"]


def test_held_bytes_are_dropped_if_the_peer_is_gone() -> None:
    """Bytes that are held when the connection is lost are not sent."""
    transport = FakeTransport()

    async def run() -> None:
        """Write, then lose the connection."""
        PairedWrites(transport, asyncio.get_running_loop()).write(b"head")
        transport.close()
        await asyncio.sleep(0)

    asyncio.run(run())
    assert transport.sent == []


def test_other_attributes_are_those_of_the_transport() -> None:
    """The address of the peer, which uvicorn reads, is that of the wrapped transport."""

    async def run() -> object:
        """Read the address in an event loop."""
        return PairedWrites(FakeTransport(), asyncio.get_running_loop()).get_extra_info("peername")

    assert asyncio.run(run()) == ("192.0.2.1", 5)


@pytest.mark.parametrize("sent", [b"", b"POST /v1/predict HTTP/1.1\r\n"], ids=["silent", "in the middle of a head"])
def test_a_lost_connection_is_released_at_once(sent: bytes) -> None:
    """No timer holds a lost connection in memory, since a proxy may open thousands of short ones."""

    async def run() -> object:
        """Open a connection, send bytes and disconnect. Return the connection if it still exists."""
        connection = FakeConnection(PlainTextResponse("fine"), None)
        connection.receive(sent)
        connection.disconnect()
        left = weakref.ref(connection.protocol)
        del connection
        gc.collect()
        return left()

    assert asyncio.run(run()) is None


async def echo(scope: Scope, receive: Receive, send: Send) -> None:
    """Answer with the body, which is read message by message."""
    content, more = b"", True
    while more:
        message = await receive()
        assert type(message["body"]) is bytes
        content, more = content + message["body"], message["more_body"]
    length = (b"content-length", b"%d" % len(content))
    await send({"type": "http.response.start", "status": 200, "headers": [length]})
    await send({"type": "http.response.body", "body": content})


@pytest.mark.parametrize(
    "sizes",
    [(9,), (70_000,), (70_000, 70_000), (70_000, 1, 2, 70_000), (1,) * 9, (0, 5), (20_000, 20_000, 90_000)],
    ids=str,
)
@pytest.mark.parametrize("at_once", [True, False], ids=["in one iteration", "in several iterations"])
def test_a_body_arrives_complete_in_any_pieces(sizes: tuple[int, ...], at_once: bool) -> None:
    """A body reaches the application unchanged, in pieces of any sizes."""
    pieces = [bytes([65 + number]) * size for number, size in enumerate(sizes)]
    whole = b"".join(pieces)

    async def run() -> bytes:
        """Send the body piece by piece."""
        connection = FakeConnection(echo, None)
        connection.receive(f"POST / HTTP/1.1\r\nHost: h\r\nContent-Length: {len(whole)}\r\n\r\n".encode())
        for piece in pieces:
            connection.receive(piece)
            if not at_once:
                await asyncio.sleep(0)
                await asyncio.sleep(0)
        return await connection.answers(1)

    assert asyncio.run(run()).partition(b"\r\n\r\n")[2] == whole
