"""Threads with a bounded queue and a deadline."""

import asyncio
import threading
from pathlib import Path

import pytest

from service.errors import DeadlineError, OverloadedError
from service.processors import processors
from service.transport.threads import ThreadPool, threads_beside_the_loop


def test_a_function_runs_in_a_thread() -> None:
    """Its result and its errors come back."""
    pool = ThreadPool(1, 0, 10.0)

    async def scenario() -> None:
        """What happens, in the loop."""
        assert await pool.run(threading.current_thread) is not threading.main_thread()
        with pytest.raises(ZeroDivisionError):
            await pool.run(divmod, 1, 0)

    asyncio.run(scenario())
    pool.close()


def test_what_does_not_fit_the_queue_is_refused_at_once() -> None:
    """One runs, one waits, the third is told; when they are done there is room again."""
    pool, release = ThreadPool(1, 1, 10.0), threading.Event()

    async def scenario() -> None:
        """What happens, in the loop."""
        first, second = (asyncio.ensure_future(pool.run(release.wait)) for _ in range(2))
        await asyncio.sleep(0)
        with pytest.raises(OverloadedError):
            await pool.run(release.wait)
        release.set()
        await asyncio.gather(first, second)
        await pool.run(release.wait)

    asyncio.run(scenario())
    pool.close()


def test_what_waits_too_long_is_told_and_never_begun() -> None:
    """The deadline counts waiting; a thread that is taken stays counted until it is free."""
    pool, release, begun = ThreadPool(1, 1, 0.05), threading.Event(), threading.Event()

    async def scenario() -> None:
        """What happens, in the loop."""
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


def test_who_leaves_takes_along_what_has_not_begun() -> None:
    """A client that hung up is not worked for; what runs for it ends by itself, and is told to nobody."""
    pool, release, begun = ThreadPool(1, 1, 10.0), threading.Event(), threading.Event()

    async def scenario() -> None:
        """What happens, in the loop."""
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
    """Its caller was told of the deadline, and the service has ended since."""
    pool, release = ThreadPool(1, 0, 0.01), threading.Event()

    async def scenario() -> None:
        """What happens, in the loop."""
        with pytest.raises(DeadlineError):
            await pool.run(release.wait)

    asyncio.run(scenario())
    release.set()
    pool.close()
    for thread in threading.enumerate():
        if thread.name.startswith("worker"):
            thread.join()
    assert caplog.text == ""


@pytest.mark.parametrize(
    ("content", "expected"), [("100000 100000", 1), ("10000 100000", 1), ("max 100000", None), ("?", None)]
)
def test_threads_follow_the_containers_quota(tmp_path: Path, content: str, expected: int | None) -> None:
    """A part of a processor is one thread; no quota is what the process is bound to."""
    path = tmp_path / "cpu.max"
    path.write_text(content)
    assert processors(path) == (expected or processors(tmp_path / "absent"))


def test_the_event_loop_is_left_a_processor_where_there_are_two() -> None:
    """Work in threads leaves it one; where there is but one, they share it."""
    assert threads_beside_the_loop() == max(1, processors() - 1)
