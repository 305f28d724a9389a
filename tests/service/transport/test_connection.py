"""Writes that leave together; the bounds on heads are tested with raw sockets in tests/test_attacks.py."""

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
    """What leaves, call by call, when this is written in one go."""

    async def run() -> list[bytes]:
        """In a loop."""
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
    ids=["an answer", "a head alone", "an empty body", "two answers", "a body in parts", "nothing, then something"],
)
def test_what_is_written_in_one_go_leaves_in_pairs(pieces: tuple[bytes, ...], calls: list[bytes]) -> None:
    """Head and body make one call, and nothing waits for longer than whoever writes."""

    def write(transport: PairedWrites) -> None:
        for piece in pieces:
            transport.write(piece)

    assert sent_by(write) == calls


def test_closing_sends_what_is_held() -> None:
    """A refusal is written and the connection closed at once: it leaves first."""

    def write(transport: PairedWrites) -> None:
        transport.write(b"refused")
        transport.close()
        assert transport.is_closing()

    assert sent_by(write) == [b"refused"]


def test_nothing_is_sent_to_a_peer_that_is_gone() -> None:
    """The connection was lost between the write and the end of it."""
    transport = FakeTransport()

    async def run() -> None:
        """Write, and lose the connection."""
        PairedWrites(transport, asyncio.get_running_loop()).write(b"head")
        transport.close()
        await asyncio.sleep(0)

    asyncio.run(run())
    assert transport.sent == []


def test_everything_else_is_the_transports_own() -> None:
    """Who the peer is, among others, which uvicorn asks."""

    async def run() -> object:
        """Ask."""
        return PairedWrites(FakeTransport(), asyncio.get_running_loop()).get_extra_info("peername")

    assert asyncio.run(run()) == ("192.0.2.1", 5)


@pytest.mark.parametrize("said", [b"", b"POST /v1/predict HTTP/1.1\r\n"], ids=["silent", "in the middle of a head"])
def test_a_connection_that_is_lost_is_not_held_until_its_time_is_over(said: bytes) -> None:
    """A clock that still looked at it would hold a proxy's thousands of short connections in memory for seconds."""

    async def run() -> object:
        """Open, say something, and be gone; what is left of it while the loop goes on."""
        connection = FakeConnection(PlainTextResponse("fine"), None)
        connection.receive(said)
        connection.disconnect()
        left = weakref.ref(connection.protocol)
        del connection
        gc.collect()
        return left()

    assert asyncio.run(run()) is None


async def echo(scope: Scope, receive: Receive, send: Send) -> None:
    """Answer with the body, read message by message."""
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
@pytest.mark.parametrize("at_once", [True, False], ids=["in one turn", "turn by turn"])
def test_a_body_arrives_as_it_was_sent_in_whatever_pieces(sizes: tuple[int, ...], at_once: bool) -> None:
    """A large piece is kept as it is, others are added to it; nothing is lost, doubled or turned around."""
    pieces = [bytes([65 + number]) * size for number, size in enumerate(sizes)]
    whole = b"".join(pieces)

    async def run() -> bytes:
        """Send piece by piece."""
        connection = FakeConnection(echo, None)
        connection.receive(f"POST / HTTP/1.1\r\nHost: h\r\nContent-Length: {len(whole)}\r\n\r\n".encode())
        for piece in pieces:
            connection.receive(piece)
            if not at_once:
                await asyncio.sleep(0)
                await asyncio.sleep(0)
        return await connection.answers(1)

    assert asyncio.run(run()).partition(b"\r\n\r\n")[2] == whole
