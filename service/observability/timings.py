"""Timings of the phases of a request, recorded where the work is done.

A context variable holds the list of timings, also in the threads that work for the request. Outside of a request, as in
a command or a test, no list is set and timings are dropped.
"""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar, Token
from typing import Final, Literal

Phase = Literal["queue", "decode", "inference"]
Timings = list[tuple[Phase, float]]
_TIMINGS: Final[ContextVar[Timings | None]] = ContextVar("timings", default=None)


def collect_timings(timings: Timings) -> Token[Timings | None]:
    """Collect in this list each (phase, seconds) that this task and its threads record from now on."""
    return _TIMINGS.set(timings)


def record_timing(phase: Phase, seconds: float) -> None:
    """Record the seconds that a phase took."""
    timings = _TIMINGS.get()
    if timings is not None:
        timings.append((phase, seconds))


@contextmanager
def timed(phase: Phase) -> Iterator[None]:
    """Record the time that the block takes, also when it fails."""
    began = time.perf_counter()
    try:
        yield
    finally:
        record_timing(phase, time.perf_counter() - began)
