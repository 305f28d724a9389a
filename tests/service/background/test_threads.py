"""Threads of one purpose are bounded, pass every outcome on, and do not keep the process."""

import asyncio
import subprocess
import sys
import threading
from contextvars import ContextVar

import pytest

from service.background.threads import NoThreadError, PurposeThreads
from tests.fakes import Panic


def raise_error(error: BaseException) -> None:
    """Raise an error."""
    raise error


def test_a_function_runs_in_a_thread_with_the_context_of_its_caller() -> None:
    """The result comes back, and context variables are those of the caller."""
    variable: ContextVar[int] = ContextVar("variable")
    threads = PurposeThreads("fake", 1)

    async def scenario() -> None:
        """Run the scenario in an event loop."""
        variable.set(7)
        assert await threads.run(lambda: (variable.get(), threading.current_thread().name)) == (7, "fake")

    asyncio.run(scenario())
    assert threads.busy == 0


@pytest.mark.parametrize("error", [ZeroDivisionError(), Panic(), StopIteration(), SystemExit(3)], ids=repr)
def test_every_error_reaches_the_caller(error: BaseException) -> None:
    """No error is lost, none hangs the caller, and an exit of the thread does not end the process."""
    threads = PurposeThreads("fake", 1)
    expected = type(error) if isinstance(error, (ZeroDivisionError, Panic)) else RuntimeError

    async def scenario() -> None:
        """Run the scenario in an event loop."""
        async with asyncio.timeout(30):
            with pytest.raises(expected):
                await threads.run(raise_error, error)

    asyncio.run(scenario())
    assert threads.busy == 0


def test_threads_beyond_the_limit_are_refused_at_once() -> None:
    """A thread that hangs counts until it ends, also if its caller has left."""
    threads, release = PurposeThreads("fake", 1), threading.Event()

    async def scenario() -> None:
        """Run the scenario in an event loop."""
        caller = asyncio.ensure_future(threads.run(release.wait))
        await asyncio.sleep(0)
        caller.cancel()
        await asyncio.wait([caller])
        assert threads.busy == 1
        with pytest.raises(NoThreadError, match="fake: all 1 threads are busy"):
            await threads.run(int)
        release.set()
        while threads.busy:
            await asyncio.sleep(0.001)
        assert await threads.run(int) == 0

    asyncio.run(scenario())


def test_a_machine_without_threads_is_an_error_of_the_call(monkeypatch: pytest.MonkeyPatch) -> None:
    """If the machine refuses a thread, the call fails and the place is free again."""
    threads = PurposeThreads("fake", 1)
    monkeypatch.setattr(threading.Thread, "start", lambda _: raise_error(RuntimeError("can't start new thread")))
    with pytest.raises(NoThreadError, match="refuses"):
        threads.submit(int)
    assert threads.busy == 0


def test_a_thread_that_hangs_does_not_keep_the_process() -> None:
    """A process ends at once although a thread hangs."""
    code = (
        "import time; from service.background.threads import PurposeThreads;"
        "PurposeThreads('fake', 1).submit(time.sleep, 3600); print('ends')"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60)
    assert done.stdout == "ends\n"
