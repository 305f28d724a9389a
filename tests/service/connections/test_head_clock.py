"""The clock of heads runs while a head is awaited, and bounds its time and its bytes."""

import asyncio
from collections.abc import Callable
from dataclasses import dataclass
from typing import cast

import pytest

from service.connections.head_clock import MAX_HEAD_BYTES, HeadClock

LIMIT_S = 10.0
IDLE_S = 75.0


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
    return HeadClock(cast(asyncio.AbstractEventLoop, loop), LIMIT_S, IDLE_S, late)


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


def test_an_idle_connection_has_its_own_limit(loop: FakeLoop, clock: HeadClock, late: Late) -> None:
    """After an answer the client may wait for longer than a head may take."""
    clock.pause()
    clock.rest()
    assert clock.is_idle
    for _ in range(int(IDLE_S / LIMIT_S)):
        loop.advance(LIMIT_S)
        assert late.count == 0
    loop.advance(LIMIT_S)
    assert late.count == 1


def test_a_head_has_the_whole_limit_from_its_first_byte(loop: FakeLoop, clock: HeadClock, late: Late) -> None:
    """The idle time before a head does not count for it."""
    clock.rest()
    loop.advance(IDLE_S - 1.0)
    clock.begin()
    assert not clock.is_idle
    loop.advance(LIMIT_S - 1.0)
    assert late.count == 0
    loop.advance(2.0)
    assert late.count == 1


def test_a_connection_tells_how_long_it_waited(loop: FakeLoop, clock: HeadClock) -> None:
    """The time counts from the last answer or the first byte, and not while a request is answered."""
    clock.rest()
    loop.advance(3.0)
    assert clock.waited_s() == 3.0
    clock.pause()
    assert clock.waited_s() == 0.0


def test_bytes_of_a_head_are_counted_up_to_the_limit(clock: HeadClock) -> None:
    """A head may have the maximum of bytes, and not one more. The next head begins at 0."""
    assert not clock.add(MAX_HEAD_BYTES - 1)
    clock.begin()  # with the last byte that was counted
    assert not clock.add(1)
    assert clock.add(1)
    for end in (clock.pause, clock.rest):
        end()
        assert not clock.add(MAX_HEAD_BYTES)


def test_a_closed_clock_leaves_no_timer(loop: FakeLoop, clock: HeadClock, late: Late) -> None:
    """A lost connection is never late, and its timer does not hold it in memory."""
    clock.close()
    assert all(timer.is_cancelled for timer in loop.timers)
    loop.advance(LIMIT_S + 1.0)
    assert late.count == 0
