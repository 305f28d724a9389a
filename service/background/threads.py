"""Threads for one purpose: bounded in number, and not awaited when the process ends.

Each purpose has its own: polling, probing, and the text of metrics. A purpose whose threads hang delays no other one.
asyncio's own executor is not used, because all purposes would share it, and the end of the event loop awaits it.
"""

import asyncio
import contextvars
import threading
from collections.abc import Callable
from concurrent.futures import Future
from typing import ParamSpec, TypeVar

from service.background.supervision import carried

P = ParamSpec("P")
T = TypeVar("T")


class NoThreadError(Exception):
    """All threads of a purpose are busy, or the machine has none left."""


class PurposeThreads:
    """Threads of one purpose, each started for one call.

    To start a thread takes about 0.1 ms, which is little for calls that happen every few seconds.

    Attributes:
        busy: number of threads that run.
    """

    def __init__(self, purpose: str, limit: int) -> None:
        self._purpose = purpose
        self._limit = limit
        self._counting = threading.Lock()
        self.busy = 0

    def submit(self, function: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> Future[T]:
        """Run a function in a new thread and return its outcome to be.

        Raises:
            NoThreadError: as many threads as the limit are busy, or the machine refuses a thread.
        """
        outcome: Future[T] = Future()
        outcome.set_running_or_notify_cancel()
        run = contextvars.copy_context().run

        def work() -> None:
            """Run the function, and settle the outcome whatever the function raises."""
            try:
                result = run(function, *args, **kwargs)
            except BaseException as error:
                self._count(-1)
                outcome.set_exception(carried(error))
            else:
                self._count(-1)
                outcome.set_result(result)

        self._enter()
        try:
            threading.Thread(target=work, name=self._purpose, daemon=True).start()
        except RuntimeError as error:
            self._count(-1)
            raise NoThreadError(f"{self._purpose}: the machine refuses another thread") from error
        return outcome

    async def run(self, function: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T:
        """Run a function in a new thread and return its result. A thread whose caller is cancelled goes on.

        Raises:
            NoThreadError: see ``submit``.
        """
        return await asyncio.wrap_future(self.submit(function, *args, **kwargs))

    def _enter(self) -> None:
        with self._counting:
            if self.busy >= self._limit:
                raise NoThreadError(f"{self._purpose}: all {self._limit} threads are busy")
            self.busy += 1

    def _count(self, change: int) -> None:
        with self._counting:
            self.busy += change
