"""Supervision of background tasks: each is repeated until the application ends, whatever it raises.

Libraries in native code raise exceptions that do not derive from ``Exception``: a panic of Rust does. Such an exception
would end a task silently, while the service goes on without it.
"""

import asyncio
import contextlib
import logging
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from dataclasses import dataclass
from typing import Final

# An exception of these ends a task because that is wanted. Every other one is a failure, also if it is no Exception.
ENDINGS: Final = (asyncio.CancelledError, GeneratorExit, KeyboardInterrupt, SystemExit)
_SLACK_S: Final = 60.0  # a poll that loads large models takes long and is not stuck
_INTERVALS: Final = 3
_STOP_S: Final = 0.2

logger = logging.getLogger(__name__)
Step = Callable[[], Awaitable[None]]


def carried(error: BaseException) -> BaseException:
    """Return the exception that a future carries from other work. The end of that work is not the end of its caller."""
    if not isinstance(error, (StopIteration, *ENDINGS)):
        return error
    failure = RuntimeError(f"the work ended by {type(error).__name__}")
    failure.__cause__ = error
    return failure


class TaskHealth:
    """Health of one background task: its age, its failures and its last error.

    Attributes:
        name: name of the task, which is its label in metrics.
        limit_s: age from which the task counts as late, in s.
        failures: number of failures since the start. The task was started again after each.
        failures_in_a_row: number of failures since the last success.
        error: type of the last failure, or None after a success. Its text may hold a path, so it is only logged.
    """

    def __init__(self, name: str, limit_s: float) -> None:
        self.name = name
        self.limit_s = limit_s
        self.failures = 0
        self.error: str | None = None
        self.failures_in_a_row = 0
        self._since: float | None = None

    def age_s(self) -> float:
        """Return the time since the last success, or 0 while the task has no work, in s."""
        since = self._since
        return 0.0 if since is None else max(0.0, time.monotonic() - since)

    def is_late(self) -> bool:
        """Return True if the task hangs, or fails each time."""
        return self.age_s() > self.limit_s

    def begin(self) -> None:
        """Begin work after a rest. The age counts from now."""
        if self._since is None:
            self._since = time.monotonic()

    def rest(self) -> None:
        """Rest: there is no work until ``begin``."""
        self._since = None

    def succeed(self) -> None:
        """Note a success."""
        self._since, self.failures_in_a_row, self.error = time.monotonic(), 0, None

    def fail(self, error: BaseException) -> None:
        """Note a failure."""
        self.failures += 1
        self.failures_in_a_row += 1
        self.error = type(error).__name__


@dataclass(frozen=True)
class _Repeated:
    health: TaskHealth
    step: Step
    interval_s: float
    first_s: float


class Supervisor:
    """Supervisor of the background tasks of one application."""

    def __init__(self) -> None:
        self._repeated: list[_Repeated] = []
        self._watched: list[TaskHealth] = []
        self._tried: dict[str, asyncio.Event] = {}

    def repeat(self, name: str, step: Step, interval_s: float, first_s: float = 0.0) -> None:
        """Run a step at this interval once the application starts, for the first time after ``first_s``."""
        health = TaskHealth(name, first_s + _INTERVALS * interval_s + _SLACK_S)
        self._repeated.append(_Repeated(health, step, interval_s, first_s))

    def watch(self, health: TaskHealth) -> None:
        """Report the health of a task that runs elsewhere."""
        self._watched.append(health)

    def health(self) -> list[TaskHealth]:
        """Return the health of every task."""
        return [*(one.health for one in self._repeated), *self._watched]

    async def first(self, name: str, limit_s: float) -> None:
        """Wait until a running task has run once, whether it failed or not, but at most this time in s."""
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(self._tried[name].wait(), limit_s)

    @contextlib.asynccontextmanager
    async def running(self) -> AsyncIterator[None]:
        """Run the tasks for as long as the block lasts."""
        self._tried = {one.health.name: asyncio.Event() for one in self._repeated}
        running = [
            asyncio.create_task(_repeat(one, self._tried[one.health.name]), name=one.health.name)
            for one in self._repeated
        ]
        try:
            yield
        finally:
            for task in running:
                task.cancel()
            if running:
                await asyncio.wait(running, timeout=_STOP_S)


async def _repeat(repeated: _Repeated, tried: asyncio.Event) -> None:
    loop = asyncio.get_running_loop()
    repeated.health.begin()
    await asyncio.sleep(repeated.first_s)
    while True:
        began = loop.time()
        await _run(repeated)
        tried.set()
        await asyncio.sleep(max(0.0, began + repeated.interval_s - loop.time()))


async def _run(repeated: _Repeated) -> None:
    """Run a step once, and note its outcome."""
    try:
        await repeated.step()
    except asyncio.CancelledError as error:
        task = asyncio.current_task()
        if task is None or task.cancelling():
            raise
        _fail(repeated.health, error)  # a part of the step was cancelled, and not the task
    except ENDINGS:
        raise
    except BaseException as error:
        _fail(repeated.health, error)
    else:
        repeated.health.succeed()


def _fail(health: TaskHealth, error: BaseException) -> None:
    """Note a failure and log its cause. A task that fails each time is logged ever more rarely."""
    health.fail(error)
    if health.failures_in_a_row.bit_count() == 1:
        extra = {"task": health.name, "failures_in_a_row": health.failures_in_a_row}
        logger.error("background task failed and is started again", extra=extra, exc_info=error)
