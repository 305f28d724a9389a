"""Deadline of a call: the time that is left for all its attempts, and the bound on each wait of its connection.

httpx bounds each wait for bytes by itself. A server that sends a byte now and then, or one informational answer after
another, could hold a blocking call for ever. ``ConnectionWatch`` is told by httpx, through its extension ``trace``, of
each new connection, and bounds the waits of that connection by the deadline of the call that uses it.
"""

import socket
import time
from collections.abc import Callable, Mapping
from contextvars import ContextVar, Token
from types import TracebackType
from typing import Any, Final, Self

_PIECE: Final = 16 * 1024  # one wait covers all of a write, and a slow reader could stretch it
_LONGEST_WAIT_S: Final = 1e6  # a socket takes no limit of more than 24 days
_NEW: Final = ("connect_tcp.complete", "connect_unix_socket.complete", "start_tls.complete")


class Deadline:
    """Deadline of one call, with all its attempts and pauses."""

    def __init__(self, limit_s: float, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._end_s = clock() + limit_s

    def left_s(self) -> float:
        """Return the time that is left, in s. It is not positive once the deadline has passed."""
        return self._end_s - self._clock()

    def bound_s(self, wait_s: float | None) -> float:
        """Return the longest time that a wait may take, in s.

        Raises:
            TimeoutError: no time is left.
        """
        left_s = min(self.left_s(), _LONGEST_WAIT_S)
        if left_s <= 0.0:
            raise TimeoutError
        return left_s if wait_s is None else min(wait_s, left_s)


_DEADLINE: ContextVar[Deadline | None] = ContextVar("deadline", default=None)


class ConnectionWatch:
    """Watch of the connection that one attempt uses. A blocking client enters it while it waits.

    Attributes:
        was_idle: whether the request was sent on an idle connection, which the service may have ended at the same time,
            and has no answer yet.
    """

    def __init__(self, deadline: Deadline) -> None:
        self.was_idle = False
        self._is_new = False
        self._deadline = deadline
        self._token: Token[Deadline | None] | None = None

    def __enter__(self) -> Self:
        self._token = _DEADLINE.set(self._deadline)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        if self._token is not None:
            _DEADLINE.reset(self._token)

    def trace(self, event: str, info: dict[str, Any]) -> None:
        """Follow a blocking connection. httpx calls this before and after each step."""
        if self._opens(event, info):
            addresses = _count_addresses(info) if event.endswith("connect_tcp.started") else 1
            info["timeout"] = self._deadline.bound_s(info["timeout"]) / addresses
        elif event.endswith(_NEW):
            _bound_waits(info["return_value"])

    async def trace_async(self, event: str, info: Mapping[str, Any]) -> None:
        """Follow a connection of asyncio, whose waits are bounded together by ``asyncio.timeout``."""
        self._opens(event, info)

    def _opens(self, event: str, info: Mapping[str, Any]) -> bool:
        """Return whether a step of opening a connection begins. Such a step has a limit of its own."""
        if event.endswith(".started") and "timeout" in info:
            self._is_new = True
            return True
        if event.endswith("send_request_headers.started"):
            self.was_idle = not self._is_new
        elif event.endswith("receive_response_headers.complete"):
            self.was_idle = False
        return False


def _bound_waits(stream: Any) -> None:
    """Bound the reads and writes of a connection by the deadline of the call that uses it at the time."""
    read, write = stream.read, stream.write

    def read_in_time(max_bytes: int, timeout: float | None = None) -> bytes:
        """Wait for bytes until the deadline."""
        content: bytes = read(max_bytes, timeout=_bound_s(timeout))
        return content

    def write_in_time(buffer: bytes, timeout: float | None = None) -> None:
        """Send bytes until the deadline."""
        for start in range(0, len(buffer), _PIECE):
            write(buffer[start : start + _PIECE], timeout=_bound_s(timeout))

    stream.read, stream.write = read_in_time, write_in_time


def _count_addresses(info: Mapping[str, Any]) -> int:
    """Return the number of addresses of a host. They are tried one after another, each with the limit of the step."""
    try:
        return max(1, len(socket.getaddrinfo(info["host"], info["port"], type=socket.SOCK_STREAM)))
    except (OSError, ValueError, OverflowError):  # connecting raises it again
        return 1


def _bound_s(wait_s: float | None) -> float | None:
    deadline = _DEADLINE.get()
    return wait_s if deadline is None else deadline.bound_s(wait_s)
