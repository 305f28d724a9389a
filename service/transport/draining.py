"""uvicorn with an end that loses nothing.

On SIGTERM the service first says that it is not ready and asks clients to leave, answer by answer, while it goes on
serving (``drain_s``); whoever routes to it has that long to notice. Then it closes its doors, finishes what is running
(``grace_s``), and ends. A second SIGTERM, or Ctrl-C, skips the first part.
"""

import asyncio
import os
import signal
import socket
import time
from collections.abc import Callable
from types import FrameType
from typing import Final

import uvicorn

from service.transport.connection import CLOSE

_QUEUE_S: Final = 0.05


class DrainingServer(uvicorn.Server):
    """A server that goes on for a while after SIGTERM."""

    def __init__(self, config: uvicorn.Config, drain_s: float, draining: Callable[[], None]) -> None:
        super().__init__(config)
        self._drain_s = drain_s
        self._draining = draining
        self._closes_at: float | None = None

    def handle_exit(self, sig: int, frame: FrameType | None) -> None:
        """A signal came; called in between of whatever runs."""
        self._draining()
        if sig != signal.SIGTERM or self._closes_at is not None:
            super().handle_exit(sig, frame)
            return
        self._closes_at = time.monotonic() + self._drain_s
        self.config.encoded_headers.append(CLOSE)  # from which uvicorn makes its headers anew, every second
        self.server_state.default_headers = [*self.server_state.default_headers, CLOSE]

    async def on_tick(self, counter: int) -> bool:
        """Ten times a second: whether to close."""
        if self._closes_at is not None and time.monotonic() >= self._closes_at:
            self.should_exit = True
        return await super().on_tick(counter)

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """Close the doors; whoever stands in the queue before them is let in first, instead of being cut off."""
        for server in self.servers:
            for listening in server.sockets:
                with socket.socket(fileno=os.dup(listening.fileno())) as same:
                    same.listen(0)  # from now on the kernel admits nobody: clients try again, and are refused
        await asyncio.sleep(_QUEUE_S)
        await super().shutdown(sockets)
