"""A server of uvicorn that ends without losing a request.

After SIGTERM the service reports that it is not ready, and asks clients with each answer to close their connection,
while it keeps serving (``drain_s``). A load balancer has that time to notice. Then the service stops accepting
connections, finishes the running requests (``grace_s``) and ends. A second SIGTERM, or Ctrl-C, skips the first part.
"""

import asyncio
import os
import signal
import socket
import time
from collections.abc import Callable, Iterable
from functools import partial
from types import FrameType
from typing import Any, Final

import uvicorn

CLOSE: Final = (b"connection", b"close")  # among the headers of every answer once the service is to end
_QUEUE_S: Final = 0.05


class DrainingServer(uvicorn.Server):
    """A server that keeps serving for some time after SIGTERM."""

    def __init__(
        self,
        config: uvicorn.Config,
        drain_s: float,
        draining: Callable[[], None],
        ending: Callable[[float], None],
        others: Iterable[tuple[socket.socket, uvicorn.Config]] = (),
    ) -> None:
        """Create a server.

        Args:
            config: configuration of uvicorn.
            drain_s: time to keep serving after SIGTERM, in s.
            draining: called by the first signal.
            ending: called by each signal with the time in which this server ends, in s.
            others: sockets on which other applications listen, in this event loop and to the same end.
        """
        super().__init__(config)
        self._drain_s = drain_s
        self._draining = draining
        self._ending = ending
        self._others = list(others)
        self._grace_s = float(config.timeout_graceful_shutdown or 0)
        self._closes_at: float | None = None

    def handle_exit(self, sig: int, frame: FrameType | None) -> None:
        """Begin to drain, or to end. A signal calls this between any two steps of other code."""
        self._draining()
        if sig != signal.SIGTERM or self._closes_at is not None:
            self._ending(self._grace_s)
            super().handle_exit(sig, frame)
            return
        self._ending(self._drain_s + self._grace_s)
        self._closes_at = time.monotonic() + self._drain_s
        self.config.encoded_headers.append(CLOSE)  # uvicorn makes its headers from these every second
        self.server_state.default_headers = [*self.server_state.default_headers, CLOSE]

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Start the application and all listeners."""
        await super().startup(sockets)
        for listening, config in self._others:
            config.load()
            protocol: Any = config.http_protocol_class
            connection = partial(protocol, config, self.server_state, self.lifespan.state)
            self.servers.append(await asyncio.get_running_loop().create_server(connection, sock=listening))

    async def on_tick(self, counter: int) -> bool:
        """Return True, ten times a second, once the server is to close."""
        if self._closes_at is not None and time.monotonic() >= self._closes_at:
            self.should_exit = True
        return await super().on_tick(counter)

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """Stop accepting connections. Those in the accept queue are accepted first, instead of being reset."""
        for server in self.servers:
            for listening in server.sockets:
                with socket.socket(fileno=os.dup(listening.fileno())) as same:
                    same.listen(0)  # from now on the kernel queues no connection: clients try again, and are refused
        await asyncio.sleep(_QUEUE_S)
        await super().shutdown(sockets)
