"""The thread pool has a bounded queue and a deadline."""

import asyncio
import threading

import pytest

from service.errors import DeadlineError, OverloadedError
from service.processors import processors
from service.transport.threads import ThreadPool, threads_beside_the_loop


def test_a_function_runs_in_a_thread() -> None:
    """A result and an error of a function in a thread reach the caller."""
    pool = ThreadPool(1, 0, 10.0)

    async def scenario() -> None:
        """Run the scenario in an event loop."""
        assert await pool.run(threading.current_thread) is not threading.main_thread()
        with pytest.raises(ZeroDivisionError):
            await pool.run(divmod, 1, 0)

    asyncio.run(scenario())
    pool.close()


def test_a_job_beyond_the_queue_is_refused_at_once() -> None:
    """With one running and one waiting job, a third is refused, and accepted once they are done."""
    pool, release = ThreadPool(1, 1, 10.0), threading.Event()

    async def scenario() -> None:
        """Run the scenario in an event loop."""
        first, second = (asyncio.ensure_future(pool.run(release.wait)) for _ in range(2))
        await asyncio.sleep(0)
        with pytest.raises(OverloadedError):
            await pool.run(release.wait)
        release.set()
        await asyncio.gather(first, second)
        await pool.run(release.wait)

    asyncio.run(scenario())
    pool.close()


def test_a_job_that_waits_too_long_is_refused_and_never_begun() -> None:
    """The deadline includes the wait, and a busy thread counts as a job until it is free."""
    pool, release, begun = ThreadPool(1, 1, 0.05), threading.Event(), threading.Event()

    async def scenario() -> None:
        """Run the scenario in an event loop."""
        holding = asyncio.ensure_future(pool.run(release.wait))
        await asyncio.sleep(0)
        with pytest.raises(DeadlineError):
            await pool.run(begun.set)
        with pytest.raises(DeadlineError):
            await holding

    asyncio.run(scenario())
    release.set()
    pool.close()
    assert not begun.is_set()


def test_a_cancelled_job_that_has_not_begun_is_dropped() -> None:
    """If a client disconnects, its waiting job never begins, and its running job ends without an effect."""
    pool, release, begun = ThreadPool(1, 1, 10.0), threading.Event(), threading.Event()

    async def scenario() -> None:
        """Run the scenario in an event loop."""
        tasks = [asyncio.ensure_future(pool.run(work)) for work in (release.wait, begun.set)]
        await asyncio.sleep(0)
        for task in tasks:
            task.cancel()
        await asyncio.wait(tasks)
        assert pool.jobs == 1
        release.set()
        await pool.run(int)

    asyncio.run(scenario())
    pool.close()
    assert not begun.is_set()


def test_a_thread_that_outlives_the_loop_is_silent(caplog: pytest.LogCaptureFixture) -> None:
    """A job that ends after its deadline and after the event loop logs no error."""
    pool, release = ThreadPool(1, 0, 0.01), threading.Event()

    async def scenario() -> None:
        """Run the scenario in an event loop."""
        with pytest.raises(DeadlineError):
            await pool.run(release.wait)

    asyncio.run(scenario())
    release.set()
    pool.close()
    for thread in threading.enumerate():
        if thread.name.startswith("worker"):
            thread.join()
    assert caplog.text == ""


def test_a_processor_is_left_to_the_event_loop() -> None:
    """The pool has one thread less than there are processors, but at least one."""
    assert threads_beside_the_loop() == max(1, processors() - 1)
