"""Asking again: after what, how often, how soon."""

from datetime import UTC, datetime

import pytest

from service.client.retries import Retries, retry_after_s


@pytest.mark.parametrize("status", [200, 400, 404, 408, 422, 429, 500, 502, 504])
def test_nothing_but_a_503_is_asked_again(status: int) -> None:
    """Whatever the header says."""
    assert Retries().pause_s(1, status, 1.0, lambda: 0.5) is None


def test_pauses_double_and_are_spread_from_nothing_to_the_whole() -> None:
    """Clients that failed together come back apart."""
    retries = Retries(attempts=9, first_s=0.1, longest_s=1.0)
    assert [retries.pause_s(attempt, 503, None, lambda: 0.0) for attempt in range(1, 9)] == [0.0] * 8
    longest = [retries.pause_s(attempt, 503, None, lambda: 1.0) for attempt in range(1, 9)]
    assert longest == pytest.approx([0.1, 0.2, 0.4, 0.8, 1.0, 1.0, 1.0, 1.0])


def test_the_last_attempt_is_the_last() -> None:
    """Attempts count the first one."""
    assert Retries(attempts=3).pause_s(2, 503, None, lambda: 0.0) == 0.0
    assert Retries(attempts=3).pause_s(3, 503, None, lambda: 0.0) is None
    assert Retries(attempts=1).pause_s(1, 503, None, lambda: 0.0) is None


def test_nobody_comes_back_before_retry_after_and_not_all_at_once_after_it() -> None:
    """The pause is what was asked for and then the spread."""
    retries = Retries(first_s=0.4)
    assert retries.pause_s(1, 503, 2.0, lambda: 0.0) == 2.0
    assert retries.pause_s(1, 503, 2.0, lambda: 0.5) == pytest.approx(2.2)


def test_a_service_that_asks_for_too_long_a_pause_is_not_asked_again() -> None:
    """The caller hears of it instead of hanging."""
    assert Retries(longest_s=5.0).pause_s(1, 503, 6.0, lambda: 0.0) is None


@pytest.mark.parametrize(
    ("header", "seconds"),
    [
        (None, None),
        ("1", 1.0),
        ("0", 0.0),
        ("Mon, 23 Nov 2026 12:00:30 GMT", 30.0),
        ("Mon, 23 Nov 2026 11:00:00 GMT", 0.0),
        ("-1", None),
        ("1.5", None),
        ("soon", None),
        ("", None),
        ("9" * 400, None),
        ("Mon, 99 Nov 2026 12:00:30 GMT", None),
    ],
)
def test_retry_after_is_a_number_or_a_date_or_nothing(header: str | None, seconds: float | None) -> None:
    """RFC 9110; whatever else comes is as if nothing had come."""
    assert retry_after_s(header, lambda: datetime(2026, 11, 23, 12, tzinfo=UTC)) == seconds
