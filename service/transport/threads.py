"""Threads for what would hold up the event loop: large batches, images. Bounded in number, in queue and in time.

A thread per processor that this container may use but one, which is the event loop's: the runtime takes one thread per
call, more would only take turns, and a loop that waits for its turn holds up everybody. What would wait behind a full
queue is refused at once, so that the caller can go elsewhere; what waits longer than the deadline is told so, and
dropped if it has not begun.
"""

import asyncio
import contextvars
import math
import os
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import ParamSpec, TypeVar

from service.errors import DeadlineError, OverloadedError
from service.observability.timings import took

P = ParamSpec("P")
T = TypeVar("T")
_CGROUP_CPU = Path("/sys/fs/cgroup/cpu.max")


class Workers:
    """A bounded pool of threads with a deadline."""

    def __init__(self, threads: int, max_waiting: int, deadline_s: float) -> None:
        self.threads = threads
        self._pool: ThreadPoolExecutor | None = None
        self._most = threads + max_waiting
        self._deadline_s = deadline_s
        self.jobs = 0  # in threads or waiting for one
        self._counting = threading.Lock()

    async def run(self, function: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T:
        """The function's result, from a thread.

        Raises:
            OverloadedError: the queue is full.
            DeadlineError: it took longer than a request may.
        """
        if self.jobs >= self._most:
            raise OverloadedError(f"{self._most} requests of work for its threads")
        if self._pool is None:
            self._pool = ThreadPoolExecutor(self.threads, thread_name_prefix="worker")
        asked = time.perf_counter()

        def work() -> T:
            """What runs in the thread."""
            took("queue", time.perf_counter() - asked)
            return function(*args, **kwargs)

        loop = asyncio.get_running_loop()
        found: asyncio.Future[T] = loop.create_future()
        job = self._pool.submit(contextvars.copy_context().run, work)
        self._count(+1)
        # when its thread is free, which may be long after its caller has left
        job.add_done_callback(lambda _: self._count(-1))
        job.add_done_callback(lambda done: _tell(loop, found, done))
        try:
            # not wait_for of a wrapped future: beside work that fills the caches they cost a tenth of a millisecond
            async with asyncio.timeout(self._deadline_s):
                return await found
        except TimeoutError as error:
            raise DeadlineError(self._deadline_s) from error
        finally:
            job.cancel()  # what has not begun

    def _count(self, change: int) -> None:
        """Called from the loop's thread and from the pool's."""
        with self._counting:
            self.jobs += change

    def close(self) -> None:
        """Drop what has not begun, and the threads; whoever runs something after that gets new ones."""
        if self._pool is not None:
            self._pool.shutdown(wait=False, cancel_futures=True)
            self._pool = None


def _tell(loop: asyncio.AbstractEventLoop, found: asyncio.Future[T], done: Future[T]) -> None:
    """Let the loop know, from a thread, what became of a job."""
    if not loop.is_closed() and not done.cancelled():
        loop.call_soon_threadsafe(_settle, found, done)


def _settle(found: asyncio.Future[T], done: Future[T]) -> None:
    if found.done():  # its caller has left
        return
    error = done.exception()
    if error is None:
        found.set_result(done.result())
    else:
        found.set_exception(error)


def threads_beside_the_loop() -> int:
    """How many threads may be busy while the event loop still finds a processor; at least one."""
    return max(1, processors() - 1)


def processors(cgroup_cpu: Path = _CGROUP_CPU) -> int:
    """How many processors this process may use: the container's quota, or those that it is bound to; at least one."""
    bound = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    try:
        quota, period = cgroup_cpu.read_text(encoding="ascii").split()
        allowed = math.ceil(int(quota) / int(period))
    except (OSError, ValueError):  # no cgroup, or "max"
        return bound
    return max(1, min(bound, allowed))
