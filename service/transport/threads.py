"""The thread pool for work that would block the event loop: large batches and images.

The pool is bounded in threads, in queue length and in time. It has one thread per available processor, less one for the
event loop: onnxruntime uses one thread per call, and a waiting event loop delays every client. A full queue refuses at
once. A job that waits longer than the deadline is dropped, unless it has begun.
"""

import asyncio
import contextvars
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import ParamSpec, TypeVar

from service.errors import DeadlineError, OverloadedError
from service.observability.timings import record_timing
from service.processors import processors

P = ParamSpec("P")
T = TypeVar("T")


class ThreadPool:
    """A pool of threads with a bounded queue and a deadline.

    Attributes:
        threads: number of threads.
        jobs: jobs that run or wait for a thread.
    """

    def __init__(self, threads: int, max_waiting: int, deadline_s: float) -> None:
        self.threads = threads
        self._pool: ThreadPoolExecutor | None = None
        self._max_jobs = threads + max_waiting
        self._deadline_s = deadline_s
        self.jobs = 0
        self._counting = threading.Lock()

    async def run(self, function: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T:
        """Run a function in a thread and return its result.

        Raises:
            OverloadedError: the queue is full.
            DeadlineError: the result took longer than a request may.
        """
        if self.jobs >= self._max_jobs:
            raise OverloadedError(f"{self._max_jobs} large batches and images")
        if self._pool is None:
            self._pool = ThreadPoolExecutor(self.threads, thread_name_prefix="worker")
        submitted = time.perf_counter()

        def work() -> T:
            """Run the function in the thread, and record the time in the queue."""
            record_timing("queue", time.perf_counter() - submitted)
            return function(*args, **kwargs)

        loop = asyncio.get_running_loop()
        result: asyncio.Future[T] = loop.create_future()
        job = self._pool.submit(contextvars.copy_context().run, work)
        self._count(+1)
        # A job counts until its thread is free, which may be long after its client has left.
        job.add_done_callback(lambda _: self._count(-1))
        job.add_done_callback(lambda done: _pass_on(loop, result, done))
        try:
            # wait_for and wrap_future would take a tenth of a millisecond beside work that fills the caches.
            async with asyncio.timeout(self._deadline_s):
                return await result
        except TimeoutError as error:
            raise DeadlineError(self._deadline_s) from error
        finally:
            job.cancel()  # has an effect only on a job that has not begun

    def _count(self, change: int) -> None:
        """Change the number of jobs. The event loop and the threads of the pool call this."""
        with self._counting:
            self.jobs += change

    def close(self) -> None:
        """Drop the jobs that have not begun, and end the threads. A later ``run`` starts new threads."""
        if self._pool is not None:
            self._pool.shutdown(wait=False, cancel_futures=True)
            self._pool = None


def _pass_on(loop: asyncio.AbstractEventLoop, result: asyncio.Future[T], done: Future[T]) -> None:
    """Pass the outcome of a job from its thread to the event loop."""
    if not loop.is_closed() and not done.cancelled():
        loop.call_soon_threadsafe(_settle, result, done)


def _settle(result: asyncio.Future[T], done: Future[T]) -> None:
    if result.done():  # its client has left
        return
    error = done.exception()
    if error is None:
        result.set_result(done.result())
    else:
        result.set_exception(error)


def threads_beside_the_loop() -> int:
    """Return the number of threads, at least 1, that leave a processor to the event loop."""
    return max(1, processors() - 1)
