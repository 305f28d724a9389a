"""Turns in the event loop: of many requests that come at once, a few are worked on in one iteration.

A request that the event loop reads costs a fraction of a millisecond to some milliseconds. The event loop works on all
that wait before it looks at a connection again, so two hundred at once would hold it for a second. With turns, each
iteration works for a few milliseconds, and then takes one of those that wait. New bytes and other answers come between.
"""

import asyncio
import time
from typing import Final

BUDGET_S: Final = 0.005


class LoopTurns:
    """Turns of the tasks of one event loop, in the order in which they asked."""

    def __init__(self, budget_s: float = BUDGET_S) -> None:
        self._budget_s = budget_s
        self._ends_s: float | None = None  # of the budget of this iteration. None: no task has had a turn in it
        self._queue = asyncio.Lock()
        self._waiting = 0  # tasks in the queue

    async def wait(self) -> None:
        """Return at once while this iteration has time left and no other task waits, else wait for a turn.

        The turn lasts until the task waits for something else.
        """
        loop = asyncio.get_running_loop()
        if not self._waiting:
            now = time.perf_counter()
            if self._ends_s is None:
                self._ends_s = now + self._budget_s
                loop.call_soon(self._begin_iteration)
                return
            if now < self._ends_s:
                return
        self._waiting += 1
        try:
            await asyncio.sleep(0)
            await self._queue.acquire()
        finally:
            self._waiting -= 1
        loop.call_soon(self._queue.release)  # in the next iteration

    def _begin_iteration(self) -> None:
        self._ends_s = None
