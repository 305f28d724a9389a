"""A connection of the service without a network: a test hands it bytes and reads the answers."""

import asyncio
from collections.abc import Iterable, Sequence

from starlette.types import ASGIApp
from uvicorn import Config
from uvicorn.server import ServerState

from service.connections.connection import BoundedConnection
from service.connections.listener import ConnectionLimits, Listener
from service.connections.shortcut_connection import connection_class
from service.errors import OverloadedError
from service.transport.fast_path import Shortcut
from service.transport.shares import Shares

_MAX_ITERATIONS = 5000
_BUSY_ITERATIONS = 50


class FakeTransport(asyncio.Transport):
    """A transport that records the bytes of each system call in ``sent``."""

    def __init__(self) -> None:
        super().__init__({"peername": ("192.0.2.1", 5)})
        self.sent: list[bytes] = []
        self.closed = False
        self.ended = False
        self.unsent = 0

    def write(self, data: bytes | bytearray | memoryview) -> None:
        """Record one call."""
        self.sent.append(bytes(data))

    def sent_answers(self) -> int:
        """Return the number of whole answers that were sent."""
        return len(whole_answers(b"".join(self.sent)))

    def writelines(self, list_of_data: Iterable[bytes | bytearray | memoryview]) -> None:
        """Record one call with all parts."""
        self.write(b"".join(list_of_data))

    def is_closing(self) -> bool:
        """Return whether the transport is closed."""
        return self.closed

    def close(self) -> None:
        """Close the transport."""
        self.closed = True

    def abort(self) -> None:
        """Close the transport."""
        self.closed = True

    def can_write_eof(self) -> bool:
        """Return True: the sending half can be closed."""
        return True

    def write_eof(self) -> None:
        """Close the sending half."""
        self.ended = True

    def set_write_buffer_limits(self, high: int | None = None, low: int | None = None) -> None:
        """Ignore the limits. A test alone decides when a client reads."""

    def get_write_buffer_size(self) -> int:
        """Return the bytes that the client has not read."""
        return self.unsent

    def pause_reading(self) -> None:
        """Do not read. A test alone decides when bytes arrive."""

    def resume_reading(self) -> None:
        """Do not read. A test alone decides when bytes arrive."""


def listener_of(
    head_s: float = 3600.0,
    idle_s: float = 3600.0,
    write_s: float = 3600.0,
    connections: int = 100,
    unsent_bytes: int = 1 << 20,
    held_bytes: int = 1 << 20,
) -> Listener:
    """Return limits that no test reaches, but those that it sets."""
    held = Shares(
        held_bytes, held_bytes, lambda limit: OverloadedError(f"{limit} bytes"), lambda _: OverloadedError("")
    )
    limits = ConnectionLimits(head_s, idle_s, write_s, connections, unsent_bytes)
    return Listener(limits, held, lambda code: "an-id")


class FakeConnection:
    """A connection to an app. Create and use it inside an event loop."""

    def __init__(
        self, app: ASGIApp, shortcut: Shortcut | None, head_s: float = 3600.0, listener: Listener | None = None
    ) -> None:
        config = Config(app, log_config=None, access_log=False, proxy_headers=False)
        config.load()
        self.state = ServerState()
        self.transport = FakeTransport()
        kind = connection_class(listener or listener_of(head_s=head_s), shortcut)
        self.protocol: BoundedConnection = kind(config, self.state, {})
        self.protocol.connection_made(self.transport)

    def receive(self, data: bytes) -> None:
        """Pass bytes of the client to the service, unless the service has closed the connection."""
        if not self.transport.closed:
            self.protocol.data_received(data)

    async def answers(self, count: int) -> bytes:
        """Wait for this number of answers, or for the end of the connection. Return all sent bytes."""
        for iteration in range(_MAX_ITERATIONS):
            if len(whole_answers(b"".join(self.transport.sent))) >= count or self.transport.closed:
                break
            await asyncio.sleep(0.0 if iteration < _BUSY_ITERATIONS else 0.001)
        await asyncio.sleep(0)
        return b"".join(self.transport.sent)

    def half_close(self) -> None:
        """Send no more, as when a client shuts its sending half. The transport closes unless the service objects."""
        if not self.transport.closed and not self.protocol.eof_received():
            self.transport.close()
            self.protocol.connection_lost(None)

    def disconnect(self) -> None:
        """Lose the connection, as when a client disappears."""
        self.transport.closed = True
        self.protocol.connection_lost(ConnectionResetError())


def post(path: str, body: bytes, headers: Sequence[str] = ("content-type: application/json",)) -> bytes:
    """Return the bytes of a POST request."""
    own = ("host: test", f"content-length: {len(body)}")
    return "\r\n".join((f"POST {path} HTTP/1.1", *own, *headers, "", "")).encode("latin-1") + body


def whole_answers(data: bytes) -> list[bytes]:
    """Split sent bytes into answers by their content lengths. One without an end is left out, and a 100."""
    found = []
    while b"\r\n\r\n" in data:
        head, _, rest = data.partition(b"\r\n\r\n")
        if head.startswith(b"HTTP/1.1 100 "):
            data = rest
            continue
        lengths = [line for line in head.lower().split(b"\r\n") if line.startswith(b"content-length: ")]
        length = int(lengths[0].partition(b": ")[2])
        if len(rest) < length:
            break
        found.append(head + b"\r\n\r\n" + rest[:length])
        data = rest[length:]
    return found
