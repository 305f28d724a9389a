"""The clock of heads runs while a head is awaited, and bounds its time and its bytes."""

import asyncio
from collections.abc import Callable
from dataclasses import dataclass
from typing import cast

import pytest

from service.transport.head_clock import MAX_HEAD_BYTES, HeadClock

LIMIT_S = 10.0


@dataclass
class FakeTimer:
    """A timer of a fake loop."""

    due_s: float
    callback: Callable[[], object]
    is_cancelled: bool = False

    def cancel(self) -> None:
        """Cancel the timer."""
        self.is_cancelled = True


class FakeLoop:
    """The part of an event loop that a clock uses, with a time that a test advances."""

    def __init__(self) -> None:
        self.now_s = 0.0
        self.timers: list[FakeTimer] = []

    def time(self) -> float:
        """Return the time of the test."""
        return self.now_s

    def call_later(self, delay: float, callback: Callable[[], object]) -> FakeTimer:
        """Keep a timer until it is due."""
        self.timers.append(FakeTimer(self.now_s + delay, callback))
        return self.timers[-1]

    def advance(self, seconds: float) -> None:
        """Let time pass, and run the timers that are due."""
        self.now_s += seconds
        due = [timer for timer in self.timers if timer.due_s <= self.now_s]
        self.timers = [timer for timer in self.timers if timer.due_s > self.now_s]
        for timer in due:
            if not timer.is_cancelled:
                timer.callback()


class Late:
    """A callback that counts late heads."""

    count = 0

    def __call__(self) -> None:
        """Count one."""
        self.count += 1


@pytest.fixture
def loop() -> FakeLoop:
    """Return a loop at time 0."""
    return FakeLoop()


@pytest.fixture
def late() -> Late:
    """Return a counter of late heads."""
    return Late()


@pytest.fixture
def clock(loop: FakeLoop, late: Late) -> HeadClock:
    """Return the clock of a new connection."""
    return HeadClock(cast(asyncio.AbstractEventLoop, loop), LIMIT_S, late)


def test_a_connection_without_a_head_is_late_after_the_limit(loop: FakeLoop, clock: HeadClock, late: Late) -> None:
    """The clock of a new connection runs from its start, and again after each late head."""
    loop.advance(LIMIT_S - 1.0)
    assert late.count == 0
    loop.advance(1.1)
    assert late.count == 1
    loop.advance(LIMIT_S + 1.0)
    assert late.count == 2


def test_a_complete_head_is_never_late(loop: FakeLoop, clock: HeadClock, late: Late) -> None:
    """A paused clock does not count the time of the body and the answer."""
    clock.begin()
    clock.pause()
    for _ in range(5):
        loop.advance(LIMIT_S + 1.0)
    assert late.count == 0


@pytest.mark.parametrize("begun", [True, False], ids=["with a first byte", "without a byte"])
def test_after_an_answer_the_next_head_has_the_whole_limit(
    loop: FakeLoop, clock: HeadClock, late: Late, begun: bool
) -> None:
    """The time of the next head counts from the end of the answer, also once its first byte has come."""
    clock.pause()
    loop.advance(LIMIT_S - 1.0)
    clock.restart()
    loop.advance(LIMIT_S - 1.0)
    if begun:
        clock.begin()
    assert late.count == 0
    loop.advance(1.1)
    assert late.count == 1


def test_a_pipelined_head_counts_from_its_first_byte(loop: FakeLoop, clock: HeadClock, late: Late) -> None:
    """A head that begins while another request is answered starts the clock."""
    clock.pause()
    loop.advance(LIMIT_S - 1.0)
    clock.begin()
    loop.advance(2.0)
    assert late.count == 0
    loop.advance(LIMIT_S)
    assert late.count == 1


def test_bytes_of_a_head_are_counted_up_to_the_limit(clock: HeadClock) -> None:
    """A head may have the maximum of bytes, and not one more."""
    clock.begin()
    assert not clock.add(MAX_HEAD_BYTES)
    assert clock.add(1)
    clock.begin()
    assert not clock.add(MAX_HEAD_BYTES)
    clock.restart()
    assert not clock.add(MAX_HEAD_BYTES)


def test_bytes_of_a_body_are_not_counted(clock: HeadClock) -> None:
    """A paused clock counts no bytes."""
    clock.pause()
    assert not clock.add(2 * MAX_HEAD_BYTES)


def test_a_closed_clock_leaves_no_timer(loop: FakeLoop, clock: HeadClock, late: Late) -> None:
    """A lost connection is never late, and its timer does not hold it in memory."""
    clock.close()
    assert all(timer.is_cancelled for timer in loop.timers)
    loop.advance(LIMIT_S + 1.0)
    assert late.count == 0
