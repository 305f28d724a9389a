"""Tests of retries: statuses, number of attempts, and pauses."""

from datetime import UTC, datetime

import pytest

from service.client.retries import Retries, retry_after_s


@pytest.mark.parametrize("status", [200, 400, 404, 408, 422, 429, 500, 502, 504])
def test_only_a_503_is_retried(status: int) -> None:
    """A status other than 503 is not retried, even with a Retry-After header."""
    assert Retries().pause_s(1, status, 1.0, lambda: 0.5) is None


def test_pauses_double_and_are_random() -> None:
    """The upper bound of the pause doubles up to its limit, and the pause is drawn between 0 and the bound."""
    retries = Retries(attempts=9, first_s=0.1, longest_s=1.0)
    assert [retries.pause_s(attempt, 503, None, lambda: 0.0) for attempt in range(1, 9)] == [0.0] * 8
    longest = [retries.pause_s(attempt, 503, None, lambda: 1.0) for attempt in range(1, 9)]
    assert longest == pytest.approx([0.1, 0.2, 0.4, 0.8, 1.0, 1.0, 1.0, 1.0])


def test_number_of_attempts_includes_the_first() -> None:
    """The number of attempts includes the first request."""
    assert Retries(attempts=3).pause_s(2, 503, None, lambda: 0.0) == 0.0
    assert Retries(attempts=3).pause_s(3, 503, None, lambda: 0.0) is None
    assert Retries(attempts=1).pause_s(1, 503, None, lambda: 0.0) is None
    assert Retries(attempts=9999, longest_s=5.0).pause_s(9998, 503, None, lambda: 1.0) == 5.0


def test_pause_is_retry_after_plus_a_random_part() -> None:
    """A pause is never shorter than Retry-After, and a random part is added to it."""
    retries = Retries(first_s=0.4)
    assert retries.pause_s(1, 503, 2.0, lambda: 0.0) == 2.0
    assert retries.pause_s(1, 503, 2.0, lambda: 0.5) == pytest.approx(2.2)


def test_retry_after_over_the_limit_ends_the_retries() -> None:
    """A Retry-After over the limit ends the retries, so the caller does not hang."""
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
def test_retry_after_is_parsed_as_a_number_or_a_date(header: str | None, seconds: float | None) -> None:
    """A Retry-After header is a number of seconds or a date (RFC 9110). Any other text counts as no header."""
    assert retry_after_s(header, lambda: datetime(2026, 11, 23, 12, tzinfo=UTC)) == seconds
