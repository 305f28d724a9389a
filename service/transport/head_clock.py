"""The clock of a connection, which bounds the head of each request in time and in bytes."""

import asyncio
from collections.abc import Callable
from typing import Final

MAX_HEAD_BYTES: Final = 64 * 1024
_SLACK_S: Final = 0.01


class HeadClock:
    """Clock that runs while a head is awaited: from the last answer, or the first byte, until the head is complete.

    Without it, a client could hold a connection for ever by sending headers slowly, or memory by sending endless ones.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop, limit_s: float, late: Callable[[], None]) -> None:
        self._loop = loop
        self._limit_s = limit_s
        self._late = late
        self._bytes = 0
        self._since: float | None = loop.time()  # None while no head is awaited
        self._timer = self._check_in(limit_s)

    def begin(self) -> None:
        """Begin a head. The time since the end of the last answer counts."""
        self._bytes = 0
        if self._since is None:
            self._since = self._loop.time()

    def restart(self) -> None:
        """Restart the clock: the next head is awaited from now on."""
        self._bytes = 0
        self._since = self._loop.time()

    def pause(self) -> None:
        """Pause the clock: the head is complete."""
        self._since = None

    def close(self) -> None:
        """Stop the clock with its connection. A timer left behind would hold the connection in memory."""
        self._timer.cancel()

    def add(self, count: int) -> bool:
        """Count bytes that were read, and return True if the head has too many."""
        if self._since is None:
            return False
        self._bytes += count
        return self._bytes > MAX_HEAD_BYTES

    def _check(self) -> None:
        left_s = self._limit_s if self._since is None else self._since + self._limit_s - self._loop.time()
        if left_s <= 0.0:
            self._late()
            left_s = self._limit_s
        self._timer = self._check_in(left_s)

    def _check_in(self, left_s: float) -> asyncio.TimerHandle:
        return self._loop.call_later(left_s + _SLACK_S, self._check)
