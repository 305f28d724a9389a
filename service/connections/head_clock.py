"""The clock of a connection, which bounds the head of each request in time and bytes, and the idle time before it."""

import asyncio
from collections.abc import Callable
from typing import Final

MAX_HEAD_BYTES: Final = 16 * 1024
_SLACK_S: Final = 0.01


class HeadClock:
    """Clock that runs while a head is awaited: from its first byte until it is complete, and while there is no byte.

    Without it, a client could hold a connection for ever by sending headers slowly, or memory by sending endless ones.

    Attributes:
        count: bytes of the head that have come.
        is_idle: True from an answer to the first byte of the next head.
    """

    def __init__(
        self, loop: asyncio.AbstractEventLoop, limit_s: float, idle_s: float, late: Callable[[], None]
    ) -> None:
        self._loop = loop
        self._limit_s = limit_s
        self._idle_s = idle_s
        self._late = late
        self.count = 0
        self.is_idle = False
        self._since: float | None = loop.time()  # None while no head is awaited
        self._timer = self._check_in(limit_s)

    def begin(self) -> None:
        """Begin a head, or a body: it has the whole limit from now on."""
        self.is_idle = False
        self._since = self._loop.time()

    def rest(self) -> None:
        """Begin the idle time: the last request is answered."""
        self.count = 0
        self.is_idle = True
        self._since = self._loop.time()

    def pause(self) -> None:
        """Pause the clock: the head is complete."""
        self.count = 0
        self.is_idle = False
        self._since = None

    def close(self) -> None:
        """Stop the clock with its connection. A timer left behind would hold the connection in memory."""
        self._timer.cancel()

    def add(self, count: int) -> bool:
        """Count bytes of a head, and return True if it has too many."""
        self.count += count
        return self.count > MAX_HEAD_BYTES

    def waited_s(self) -> float:
        """Return the time for which the connection has waited for a byte or for the rest of a head, in s."""
        return 0.0 if self._since is None else self._loop.time() - self._since

    def _check(self) -> None:
        left_s = self._limit_s
        if self._since is not None:
            left_s = (self._idle_s if self.is_idle else self._limit_s) - self.waited_s()
        if left_s <= 0.0:
            self._late()
            left_s = self._limit_s
        # The limit may become the shorter one at any time, so the clock looks that often.
        self._timer = self._check_in(min(left_s, self._limit_s))

    def _check_in(self, left_s: float) -> asyncio.TimerHandle:
        return self._loop.call_later(left_s + _SLACK_S, self._check)
