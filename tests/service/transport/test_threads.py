"""The thread pool has a bounded queue and a deadline, and its jobs take turns."""

import asyncio
import threading

import pytest

from service.errors import DeadlineError, OverloadedError
from service.processors import processors
from service.transport.threads import LARGE_BYTES, ThreadPool, threads_beside_the_loop
from service.turns import ending, pause


class NotingPool(ThreadPool):
    """A pool that counts how often it gives memory back."""

    given_back = 0

    def give_back(self) -> None:
        """See ``ThreadPool.give_back``."""
        super().give_back()
        self.given_back += 1


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


def parts_of(name: str, number: int, done: list[str], begun: threading.Event, go_on: threading.Event) -> str:
    """Work in this many parts, noting each, with a pause between them. The first part ends once it may."""
    begun.set()
    assert go_on.wait(10.0)
    for part in range(number):
        if part:
            pause()
        done.append(name)
    return name


def test_a_job_of_another_caller_comes_between() -> None:
    """While one caller has the only thread with a long job, a short one of another caller is done after one part."""
    pool, done = ThreadPool(1, 8, 10.0), list[str]()
    begun, go_on = threading.Event(), threading.Event()

    async def scenario() -> None:
        """Run the scenario in an event loop."""
        long = asyncio.create_task(pool.run(parts_of, "long", 16, done, begun, go_on, caller="a"))
        await asyncio.to_thread(begun.wait)
        same = asyncio.create_task(pool.run(parts_of, "same", 1, done, begun, go_on, caller="a"))
        other = asyncio.create_task(pool.run(parts_of, "other", 1, done, begun, go_on, caller="b"))
        await asyncio.sleep(0)
        go_on.set()
        assert [await task for task in (long, same, other)] == ["long", "same", "other"]

    asyncio.run(scenario())
    pool.close()
    assert done == ["long", "other", *["long"] * 15, "same"]
    assert pool.jobs == 0


def wait_for_the_end(begun: threading.Event, ended: threading.Event) -> None:
    """Work until the answer is no longer wanted, as a graph does that is told to end."""
    with ending(ended.set):
        begun.set()
        assert ended.wait(10.0)
    pause()


def pause_for_ever(begun: threading.Event, ended: threading.Event) -> None:
    """Pause again and again, until a pause says that the answer is no longer wanted."""
    begun.set()
    try:
        while True:
            pause()
    finally:
        ended.set()


@pytest.mark.parametrize("work", [wait_for_the_end, pause_for_ever])
@pytest.mark.parametrize("reason", ["deadline", "client left", "pool closed"])
def test_a_job_that_nobody_waits_for_frees_its_thread(reason: str, work: object) -> None:
    """At its deadline, when its client leaves, and when the pool is closed, a job ends early."""
    assert callable(work)
    pool = ThreadPool(1, 8, 0.05 if reason == "deadline" else 60.0)
    begun, ended = threading.Event(), threading.Event()

    async def scenario() -> None:
        """Run the scenario in an event loop."""
        running = asyncio.create_task(pool.run(work, begun, ended))
        assert await asyncio.to_thread(begun.wait, 10.0)
        if reason == "client left":
            running.cancel()
        elif reason == "pool closed":
            pool.close()
        expected = asyncio.CancelledError if reason == "client left" else DeadlineError
        with pytest.raises(expected):
            await running
        assert await asyncio.to_thread(ended.wait, 10.0)
        assert await pool.run(int) == 0  # in the only thread

    asyncio.run(scenario())
    pool.close()


def test_a_paused_job_ends_at_its_deadline() -> None:
    """A job that waits for its next turn, while another has the thread, ends at its deadline as well."""
    pool, release, begun = ThreadPool(1, 8, 0.2), threading.Event(), threading.Event()
    outcome = list[str]()

    def work() -> None:
        begun.wait(10.0)
        try:
            pause()
        except DeadlineError:
            outcome.append("ended")

    async def scenario() -> None:
        """Run the scenario in an event loop."""
        paused = asyncio.create_task(pool.run(work, caller="a"))
        await asyncio.sleep(0)
        holding = asyncio.create_task(pool.run(release.wait, caller="b"))
        await asyncio.sleep(0)
        begun.set()
        for task in (paused, holding):
            with pytest.raises(DeadlineError):
                await task

    asyncio.run(scenario())
    release.set()
    pool.close()
    for thread in threading.enumerate():
        if thread.name.startswith("worker"):
            thread.join()
    assert outcome == ["ended"]
    assert pool.jobs == 0


def test_a_dropped_job_gets_its_refusal() -> None:
    """In a full queue the newest job of the caller with the most is refused for one of another caller."""
    pool, release = ThreadPool(1, 2, 10.0), threading.Event()

    async def scenario() -> None:
        """Run the scenario in an event loop."""
        kept, waiting, newest = (asyncio.create_task(pool.run(release.wait, caller="a")) for _ in range(3))
        await asyncio.sleep(0)
        other = asyncio.create_task(pool.run(release.wait, caller="b"))
        with pytest.raises(OverloadedError):
            await newest
        release.set()
        assert [await task for task in (kept, waiting, other)] == [True] * 3

    asyncio.run(scenario())
    pool.close()


def test_outside_of_a_pool_work_never_pauses() -> None:
    """In a command or a test ``pause`` returns at once, and nothing ends the work."""
    pause(1 << 60)
    with ending(lambda: pytest.fail("ended")):
        pause()


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


@pytest.mark.parametrize("size", [LARGE_BYTES - 1, LARGE_BYTES])
def test_memory_is_given_back_after_large_jobs(size: int) -> None:
    """A moment after the last large job has ended, freed memory goes back to the system, and again after the next."""
    pool = NotingPool(1, 8, 10.0, idle_s=0.01)

    async def scenario() -> None:
        """Run two jobs, with the next only after the memory of the first was given back."""
        for _ in range(2):
            await pool.run(int, size_bytes=size)
            await asyncio.sleep(0.2)

    asyncio.run(scenario())
    pool.close()
    assert pool.given_back == (2 if size >= LARGE_BYTES else 0)


def test_memory_is_kept_while_jobs_work() -> None:
    """Memory that the next picture would take again is not given back between two of them."""
    pool, release = NotingPool(1, 8, 10.0, idle_s=0.01), threading.Event()

    async def scenario() -> int:
        """Run a large job, and a job that outlasts the moment after it."""
        await pool.run(int, size_bytes=LARGE_BYTES)
        other = asyncio.create_task(pool.run(release.wait))
        await asyncio.sleep(0.2)
        found = pool.given_back
        release.set()
        await other
        await asyncio.sleep(0.2)
        return found

    assert asyncio.run(scenario()) == 0
    pool.close()
    assert pool.given_back == 1
