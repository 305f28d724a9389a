"""Timings are collected per request, also in its threads."""

import asyncio

import pytest

from service.observability.timings import Timings, collect_timings, record_timing, timed
from service.transport.threads import ThreadPool


def test_timings_outside_of_a_request_are_dropped() -> None:
    """A command that predicts collects no timings, and recording them has no effect."""
    record_timing("decode", 1.0)
    with timed("decode"):
        pass


def test_concurrent_requests_collect_their_own_timings() -> None:
    """Each task has its own list, also in its threads, and the wait for a thread is a phase."""
    threads = ThreadPool(2, 8, 10.0)

    async def request(seconds: float) -> Timings:
        """Run a request that works in a thread."""
        timings: Timings = []
        collect_timings(timings)
        await threads.run(record_timing, "inference", seconds)
        return timings

    async def scenario() -> None:
        """Run the scenario in an event loop."""
        first, second = await asyncio.gather(request(1.0), request(2.0))
        assert [phase for phase, _ in first] == ["queue", "inference"]
        assert (first[1], second[1]) == (("inference", 1.0), ("inference", 2.0))

    asyncio.run(scenario())
    threads.close()


def test_a_phase_that_fails_is_timed() -> None:
    """A block that raises an exception is timed too."""

    async def scenario() -> None:
        """Run the scenario in an event loop."""
        timings: Timings = []
        collect_timings(timings)
        with pytest.raises(ZeroDivisionError), timed("decode"):
            raise ZeroDivisionError
        ((phase, seconds),) = timings
        assert (phase, seconds >= 0.0) == ("decode", True)

    asyncio.run(scenario())
