"""Requests that come at once take turns in the event loop, so that it is never held by all of them."""

import asyncio
from collections import Counter
from collections.abc import Callable, Coroutine
from contextlib import suppress
from typing import Any

import pytest

from service.transport.loop_turns import LoopTurns

WHOLE_TEST_S = 3600.0


class Iterations:
    """A count of the iterations of an event loop."""

    def __init__(self) -> None:
        self.count = 0
        self._next()

    def _next(self) -> None:
        self.count += 1
        asyncio.get_running_loop().call_soon(self._next)


def run(scenario: Callable[[Iterations], Coroutine[Any, Any, None]]) -> None:
    """Run a scenario for at most a minute."""

    async def bounded() -> None:
        """Run it with a time limit."""
        async with asyncio.timeout(60):
            await scenario(Iterations())

    asyncio.run(bounded())


@pytest.mark.parametrize(("budget_s", "most"), [(0.0, 1), (WHOLE_TEST_S, 50)])
def test_an_iteration_works_for_its_budget_and_no_longer(budget_s: float, most: int) -> None:
    """With no time left each of fifty tasks has an iteration of its own. With time left they share one."""

    async def scenario(iterations: Iterations) -> None:
        """Start all tasks in one iteration."""
        turns, worked = LoopTurns(budget_s), list[int]()

        async def work(number: int) -> None:
            """Wait for a turn, and note the iteration and the number."""
            await turns.wait()
            worked.append(iterations.count)
            order.append(number)

        order: list[int] = []
        await asyncio.gather(*map(work, range(50)))
        assert max(Counter(worked).values()) == most
        assert order == list(range(50))

    run(scenario)


def test_a_newcomer_does_not_pass_those_that_wait() -> None:
    """A task of a later iteration, which has time left, waits behind the others."""

    async def scenario(_: Iterations) -> None:
        """Start ten tasks, and another one while they wait."""
        turns, order = LoopTurns(0.0), list[str]()

        async def work(name: str) -> None:
            """Wait for a turn, and note the name."""
            await turns.wait()
            order.append(name)

        first = [asyncio.create_task(work("first")) for _ in range(10)]
        await asyncio.sleep(0)
        await asyncio.sleep(0)
        await asyncio.gather(work("newcomer"), *first)
        assert order == ["first"] * 10 + ["newcomer"]

    run(scenario)


def test_a_task_that_ends_while_it_waits_delays_no_other() -> None:
    """The turn of a client that has left goes to the next one."""

    async def scenario(_: Iterations) -> None:
        """End every second task."""
        turns = LoopTurns(0.0)
        tasks = [asyncio.create_task(turns.wait()) for _ in range(20)]
        await asyncio.sleep(0)
        for task in tasks[1::2]:
            task.cancel()
        for task in tasks:
            with suppress(asyncio.CancelledError):
                await task
        assert [task.cancelled() for task in tasks] == [False, True] * 10

    run(scenario)
