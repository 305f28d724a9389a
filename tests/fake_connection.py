"""A connection of the service without a network: what is said on it, in which pieces, and what was answered."""

import asyncio
from collections.abc import Iterable, Sequence

from starlette.types import ASGIApp
from uvicorn import Config
from uvicorn.server import ServerState

from service.transport.connection import BoundedConnection, connection_class
from service.transport.fast_path import Shortcut

_PATIENCE_TURNS = 5000
_QUICK_TURNS = 50


class FakeTransport(asyncio.Transport):
    """Remembers what each call to the system would have carried."""

    def __init__(self) -> None:
        super().__init__({"peername": ("192.0.2.1", 5)})
        self.sent: list[bytes] = []
        self.closed = False

    def write(self, data: bytes | bytearray | memoryview) -> None:
        """One call."""
        self.sent.append(bytes(data))

    def writelines(self, list_of_data: Iterable[bytes | bytearray | memoryview]) -> None:
        """One call too."""
        self.write(b"".join(list_of_data))

    def is_closing(self) -> bool:
        """Whether it was closed."""
        return self.closed

    def close(self) -> None:
        """No more."""
        self.closed = True

    def pause_reading(self) -> None:
        """Nothing comes by itself."""

    def resume_reading(self) -> None:
        """As above."""


class Wire:
    """One connection to an app; made and used inside of an event loop."""

    def __init__(self, app: ASGIApp, shortcut: Shortcut | None, head_s: float = 3600.0) -> None:
        config = Config(app, log_config=None, access_log=False, proxy_headers=False)
        config.load()
        self.state = ServerState()
        self.transport = FakeTransport()
        kind = connection_class(head_s, lambda code: None, shortcut)
        self.connection: BoundedConnection = kind(config, self.state, {})
        self.connection.connection_made(self.transport)

    def say(self, data: bytes) -> None:
        """A piece comes, unless the service has hung up."""
        if not self.transport.closed:
            self.connection.data_received(data)

    async def heard(self, answers: int) -> bytes:
        """What was answered, once it is so many answers or the end of the connection."""
        for turn in range(_PATIENCE_TURNS):
            if len(whole_answers(b"".join(self.transport.sent))) >= answers or self.transport.closed:
                break
            await asyncio.sleep(0.0 if turn < _QUICK_TURNS else 0.001)
        await asyncio.sleep(0)
        return b"".join(self.transport.sent)

    def lose(self) -> None:
        """The client is gone."""
        self.transport.closed = True
        self.connection.connection_lost(ConnectionResetError())


def post(path: str, body: bytes, headers: Sequence[str] = ("content-type: application/json",)) -> bytes:
    """A request as it travels."""
    own = ("host: test", f"content-length: {len(body)}")
    return "\r\n".join((f"POST {path} HTTP/1.1", *own, *headers, "", "")).encode("latin-1") + body


def whole_answers(data: bytes) -> list[bytes]:
    """The answers in what was sent that are whole; the service says the length of each."""
    found = []
    while b"\r\n\r\n" in data:
        head, _, rest = data.partition(b"\r\n\r\n")
        lengths = [line for line in head.lower().split(b"\r\n") if line.startswith(b"content-length: ")]
        length = int(lengths[0].partition(b": ")[2])
        if len(rest) < length:
            break
        found.append(head + b"\r\n\r\n" + rest[:length])
        data = rest[length:]
    return found
