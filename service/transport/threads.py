"""The thread pool for work that would block the event loop: large batches and images.

The pool is bounded in threads, in memory, in queue length and in time, and shared by callers. It has one thread per
available processor, less one for the event loop: onnxruntime uses one thread per call, and a waiting event loop delays
every client.

Jobs work in turns. Between its parts a job pauses (``service.turns``), and the next turn is the one that ``fair_queue``
gives: a picture of one caller comes between the sixteen of another. At its deadline, or once its client has left, a job
that has not begun is dropped. One that has begun ends at its next pause, or at the next node of the graph that it runs.
"""

import asyncio
import contextvars
import ctypes
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import cache, partial
from typing import Any, Final, TypeVar, TypeVarTuple

from service.background.supervision import carried
from service.errors import DeadlineError
from service.observability.timings import record_timing
from service.processors import processors
from service.transport.fair_queue import MAX_PAUSED, FairQueue, Job
from service.turns import TURN

T = TypeVar("T")
Ts = TypeVarTuple("Ts")
MAX_BYTES: Final = 256 << 20
LARGE_BYTES: Final = 1 << 20  # a job with more leaves freed memory that is worth giving back
IDLE_S: Final = 2.0  # without a job, before freed memory is given back: the next picture would take it again
KEPT_BYTES: Final = 4 << 20


class _ThreadJob(Job):
    """A job in a thread, which is also the turn that its code sees.

    Attributes:
        work: runs in the thread, and returns a function that delivers the outcome.
        refuse: delivers an error in place of an outcome.
        since: start of its turn, as of ``time.perf_counter``.
        unwanted: its answer is late, or its client has left.
        ends: functions to call when it becomes unwanted.
        resumed: set when a paused job goes on.
    """

    def __init__(self, pool: "ThreadPool", caller: str, base_bytes: int) -> None:
        super().__init__(caller, base_bytes)
        self._pool = pool
        self.work: Callable[[], Callable[[], None]]
        self.refuse: Callable[[Exception], None]
        self.since = 0.0
        self.unwanted = False
        self.ends: list[Callable[[], None]] = []
        self.resumed = threading.Event()

    def pause(self, needed_bytes: int) -> None:
        """See ``service.turns.pause``."""
        self._pool.pause(self, needed_bytes)

    @contextmanager
    def ending(self, end: Callable[[], None]) -> Iterator[None]:
        """See ``service.turns.ending``."""
        self.ends.append(end)
        try:
            if self.unwanted:  # asked after the line above: the pool sets it, and then calls all ends in the list
                raise DeadlineError(self._pool.deadline_s)
            yield
        finally:
            self.ends.remove(end)


class ThreadPool:
    """A pool of threads whose jobs take turns.

    Attributes:
        threads: number of threads that work at a time.
        deadline_s: time that a job may take, including its wait, in s.
    """

    def __init__(
        self,
        threads: int,
        max_waiting: int,
        deadline_s: float,
        max_bytes: int = MAX_BYTES,
        idle_s: float = IDLE_S,
    ) -> None:
        self._idle_s = idle_s
        self.threads = threads
        self.deadline_s = deadline_s
        self._pool: ThreadPoolExecutor | None = None
        self._queue: FairQueue[_ThreadJob] = FairQueue(threads, max_waiting, max_bytes)
        self._lock = threading.Lock()  # of the pool, the queue and the state of every job
        self._returning = False  # freed memory to the system, in a moment

    @property
    def jobs(self) -> int:
        """Return the number of jobs that wait, work or pause."""
        return self._queue.jobs

    async def run(self, function: Callable[[*Ts], T], *args: *Ts, caller: str = "", size_bytes: int = 0) -> T:
        """Run a function in a thread and return its result.

        Args:
            function: the function, which may call ``service.turns.pause``.
            args: its arguments.
            caller: the caller whose share of the threads it takes.
            size_bytes: memory that it takes from beginning to end, at most.

        Raises:
            OverloadedError: the queue is full.
            DeadlineError: the result took longer than a request may.
        """
        submitted = time.perf_counter()
        loop = asyncio.get_running_loop()
        result: asyncio.Future[T] = loop.create_future()

        def deliver(settle: Callable[[Any], None], outcome: Any) -> None:
            """Pass an outcome from the thread to the event loop."""
            if not loop.is_closed():
                loop.call_soon_threadsafe(_settle, result, settle, outcome)

        def work() -> Callable[[], None]:
            """Run the function in the thread, and record the time in the queue."""
            TURN.set(job)
            record_timing("queue", time.perf_counter() - submitted)
            try:
                return partial(deliver, result.set_result, function(*args))
            except BaseException as error:  # the client needs an answer to any of them
                return partial(deliver, result.set_exception, carried(error))

        job = _ThreadJob(self, caller, size_bytes)
        job.work = partial(contextvars.copy_context().run, work)
        job.refuse = partial(deliver, result.set_exception)
        self._submit(job)
        try:
            # wait_for and wrap_future would take a tenth of a millisecond beside work that fills the caches.
            async with asyncio.timeout(self.deadline_s):
                return await result
        except TimeoutError as error:
            raise DeadlineError(self.deadline_s) from error
        finally:
            self._end(job)
            job.work = _done  # a job that held its own work would keep the request until the next garbage collection
            if job.most_bytes >= LARGE_BYTES and not self._returning:
                self._returning = True
                loop.call_later(self._idle_s, self._give_back_once_idle, loop)

    def _give_back_once_idle(self, loop: asyncio.AbstractEventLoop) -> None:
        if self.jobs:
            loop.call_later(self._idle_s, self._give_back_once_idle, loop)
        else:
            self._returning = False
            self.give_back()

    def give_back(self) -> None:
        """Give freed memory back to the system, in a thread. The allocator keeps what its threads have freed."""
        trim = _malloc_trim()
        if trim is not None and self._pool is not None:
            self._pool.submit(trim, KEPT_BYTES)

    def pause(self, job: _ThreadJob, needed_bytes: int) -> None:
        """Let a job wait for its next turn, in its thread.

        Raises:
            DeadlineError: its answer is no longer wanted.
        """
        with self._lock:
            if job.unwanted:
                raise DeadlineError(self.deadline_s)
            job.resumed.clear()
            self._queue.pause(job, time.perf_counter() - job.since, needed_bytes)
            self._dispatch()
        job.resumed.wait()
        if job.unwanted:
            raise DeadlineError(self.deadline_s)

    def close(self) -> None:
        """Drop the jobs that have not begun, and end the others early. A later ``run`` starts new threads."""
        with self._lock:
            pool, self._pool = self._pool, None
            jobs = self._queue.every()
        for job in jobs:
            self._end(job)
        if pool is not None:
            pool.shutdown(wait=False)

    def _submit(self, job: _ThreadJob) -> None:
        with self._lock:
            dropped = self._queue.add(job)
            if self._pool is None:
                self._pool = ThreadPoolExecutor(self.threads + MAX_PAUSED, thread_name_prefix="worker")
            self._dispatch()
        if dropped is not None:
            dropped.refuse(self._queue.overloaded())

    def _dispatch(self) -> None:
        """Let all jobs work that have a turn."""
        while self._pool is not None:
            job = self._queue.take()
            if job is None:
                return
            is_paused, job.since = job.since > 0.0, time.perf_counter()
            if is_paused:
                job.resumed.set()
            else:
                self._pool.submit(self._work, job)

    def _work(self, job: _ThreadJob) -> None:
        """Run a job in this thread, to its end. It counts until then, which may be long after its client has left."""
        deliver = None if job.unwanted else job.work()
        with self._lock:
            self._queue.finish(job, time.perf_counter() - job.since)
            self._dispatch()
        if deliver is not None:
            deliver()

    def _end(self, job: _ThreadJob) -> None:
        """End a job whose answer is no longer wanted, unless it has finished."""
        with self._lock:
            if job.finished or job.unwanted:
                return
            job.unwanted = True
            if not job.working:
                self._queue.drop(job)
                self._dispatch()  # others may have waited for the room that it wanted
        for end in list(job.ends):
            end()
        job.resumed.set()


def _done() -> Callable[[], None]:
    """Stand for the work of a job whose answer was given."""
    return lambda: None


def _settle(result: "asyncio.Future[Any]", settle: Callable[[Any], None], outcome: Any) -> None:
    if not result.done():  # otherwise its client has left
        settle(outcome)


@cache
def _malloc_trim() -> Callable[[int], int] | None:
    """Return the function of glibc that gives freed memory back, or None with another allocator."""
    found: Callable[[int], int] | None = getattr(ctypes.CDLL(None), "malloc_trim", None)
    return found


def threads_beside_the_loop() -> int:
    """Return the number of threads, at least 1, that leave a processor to the event loop."""
    return max(1, processors() - 1)
