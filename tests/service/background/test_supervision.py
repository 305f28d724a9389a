"""Background tasks are repeated through every error, and their health shows it."""

import asyncio
import logging
from collections.abc import Awaitable, Callable

import pytest

from service.background.supervision import Supervisor, TaskHealth
from tests.fakes import Panic

Step = Callable[[], Awaitable[None]]


async def cancel_a_part() -> None:
    """Cancel a part of the step, but not the step."""
    part = asyncio.ensure_future(asyncio.sleep(60))
    asyncio.get_running_loop().call_soon(part.cancel)
    await part


async def hang() -> None:
    """Wait for ever."""
    await asyncio.Event().wait()


class Faulty:
    """A step that fails some times, and then succeeds."""

    def __init__(self, fail: Step, times: int) -> None:
        self.fail = fail
        self.left = times
        self.successes = 0

    async def __call__(self) -> None:
        """Fail, or succeed."""
        if self.left:
            self.left -= 1
            await self.fail()
        self.successes += 1


def raising(error: BaseException) -> Step:
    """Return a step that raises an error."""

    async def fail() -> None:
        raise error

    return fail


async def run_until(supervisor: Supervisor, condition: Callable[[], bool]) -> None:
    """Run the tasks until a condition holds."""
    async with asyncio.timeout(30), supervisor.running():
        while not condition():
            await asyncio.sleep(0.001)


@pytest.mark.parametrize(
    ("fail", "name"),
    [
        (raising(ZeroDivisionError("the fake has a bug")), "ZeroDivisionError"),
        (raising(Panic("the fake panics")), "Panic"),
        (cancel_a_part, "CancelledError"),
    ],
    ids=["exception", "panic", "cancelled part"],
)
def test_a_task_goes_on_after_any_failure(fail: Step, name: str, caplog: pytest.LogCaptureFixture) -> None:
    """A step that fails is run again, its failures are counted, and the log has the cause."""
    supervisor, step = Supervisor(), Faulty(fail, times=3)
    supervisor.repeat("fake", step, 0.001)
    (health,) = supervisor.health()
    asyncio.run(run_until(supervisor, lambda: step.successes > 1))
    assert (health.error, health.failures, health.failures_in_a_row) == (None, 3, 0)
    logged = [record for record in caplog.records if record.message.startswith("background task failed")]
    assert len(logged) == 2  # the first and the second of three in a row
    assert all(record.exc_info and type(record.exc_info[1]).__name__ == name for record in logged)
    assert logged[0].__dict__["task"] == "fake"


def test_a_task_that_hangs_grows_old_and_delays_no_other() -> None:
    """The age of a task that hangs passes its limit. Another task goes on, and the end does not await the first."""
    supervisor, step = Supervisor(), Faulty(hang, times=0)
    supervisor.repeat("hangs", hang, 0.001)
    supervisor.repeat("works", step, 0.001)
    hanging, working = supervisor.health()
    hanging.limit_s = 0.01
    asyncio.run(run_until(supervisor, lambda: hanging.is_late() and step.successes > 3))
    assert not working.is_late()
    assert working.age_s() < hanging.age_s()


def test_a_task_that_fails_each_time_is_late() -> None:
    """Failures do not make a task young, and its health names the last one."""
    supervisor = Supervisor()
    supervisor.repeat("fails", raising(Panic()), 0.001)
    (health,) = supervisor.health()
    health.limit_s = 0.01
    asyncio.run(run_until(supervisor, lambda: health.is_late() and health.failures > 1))
    assert health.error == "Panic"


@pytest.mark.parametrize(("step", "limit_s"), [(raising(Panic()), 3600.0), (hang, 0.01)], ids=["panic", "hang"])
def test_the_first_run_is_awaited_whether_it_fails_or_hangs(step: Step, limit_s: float) -> None:
    """The start awaits the first run of a task, but only for a limited time."""

    async def scenario() -> None:
        """Await the first run in an event loop."""
        supervisor = Supervisor()
        supervisor.repeat("fake", step, 3600.0)
        async with asyncio.timeout(30), supervisor.running():
            await supervisor.first("fake", limit_s)

    asyncio.run(scenario())


def test_a_task_that_ignores_its_cancellation_does_not_delay_the_end() -> None:
    """The end awaits the tasks for a moment only."""

    async def scenario() -> None:
        """Run the scenario in an event loop."""
        began, ended = asyncio.Event(), asyncio.Event()

        async def stubborn() -> None:
            """Swallow the first cancellation."""
            began.set()
            try:
                await ended.wait()
            except asyncio.CancelledError:
                await ended.wait()

        supervisor = Supervisor()
        supervisor.repeat("stubborn", stubborn, 3600.0)
        async with asyncio.timeout(30), supervisor.running():
            await began.wait()
        ended.set()

    asyncio.run(scenario())


@pytest.mark.parametrize("ending", [KeyboardInterrupt, SystemExit])
def test_an_end_of_the_process_is_no_failure(ending: type[BaseException], caplog: pytest.LogCaptureFixture) -> None:
    """Ctrl-C and an exit pass through."""
    caplog.set_level(logging.ERROR)
    supervisor = Supervisor()
    supervisor.repeat("fake", raising(ending()), 0.001)
    with pytest.raises(ending):
        asyncio.run(run_until(supervisor, lambda: False))
    assert supervisor.health()[0].failures == 0
    assert caplog.records == []


def test_a_task_without_work_has_no_age() -> None:
    """A task rests until it begins. To begin again does not make it younger."""
    health = TaskHealth("fake", 0.0)
    assert (health.age_s(), health.is_late()) == (0.0, False)
    health.begin()
    before = health.age_s()
    health.begin()
    assert health.age_s() >= before
    health.rest()
    assert health.age_s() == 0.0
