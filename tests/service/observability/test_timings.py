"""Timings of a request tell what they took to whoever listens."""

import asyncio

import pytest

from service.observability.timings import Timings, collect_timings, record_timing, timed
from service.transport.threads import ThreadPool


def test_what_is_told_outside_of_a_request_is_not_kept() -> None:
    """A command that predicts has nobody who listens."""
    record_timing("decode", 1.0)
    with timed("decode"):
        pass


def test_two_requests_at_once_hear_their_own_timings() -> None:
    """Each task has its own list, in the threads that work for it too; waiting for a thread is a part."""
    threads = ThreadPool(2, 8, 10.0)

    async def request(seconds: float) -> Timings:
        """One request."""
        timings: Timings = []
        collect_timings(timings)
        await threads.run(record_timing, "inference", seconds)
        return timings

    async def scenario() -> None:
        """What happens, in the loop."""
        first, second = await asyncio.gather(request(1.0), request(2.0))
        assert [part for part, _ in first] == ["queue", "inference"]
        assert (first[1], second[1]) == (("inference", 1.0), ("inference", 2.0))

    asyncio.run(scenario())
    threads.close()


def test_a_part_that_fails_is_timed_too() -> None:
    """A picture that is broken after a second of decoding took a second."""

    async def scenario() -> None:
        """What happens, in the loop."""
        timings: Timings = []
        collect_timings(timings)
        with pytest.raises(ZeroDivisionError), timed("decode"):
            raise ZeroDivisionError
        ((part, seconds),) = timings
        assert (part, seconds >= 0.0) == ("decode", True)

    asyncio.run(scenario())
