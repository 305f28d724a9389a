"""Retries after a 503: pauses that grow, differ between clients, and respect Retry-After.

A prediction has no side effects, so repeating a request is always safe. Only a 503 promises that a retry may succeed.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from email.utils import parsedate_to_datetime
from http import HTTPStatus
from typing import Final

_DOUBLINGS: Final = 100  # more than any pause takes, and few enough for a number


@dataclass(frozen=True, slots=True)
class Retries:
    """Number and pauses of retries."""

    attempts: int = 4
    """Maximum number of requests, including the first."""
    first_s: float = 0.1
    """Upper bound of the pause before the second request, in s. It doubles with each further request."""
    longest_s: float = 5.0
    """Upper bound of all pauses, in s. A service that asks for a longer one is not asked again."""

    def pause_s(
        self, attempt: int, status: int, retry_after_s: float | None, draw: Callable[[], float]
    ) -> float | None:
        """Return the pause after this attempt (the first is 1) in s, or None for no further attempt.

        ``draw`` returns a number in [0, 1). The pause is uniform between 0 and its bound, so clients that failed
        together retry at different times.
        """
        if status != HTTPStatus.SERVICE_UNAVAILABLE or attempt >= self.attempts:
            return None
        asked_s = retry_after_s or 0.0
        if asked_s > self.longest_s:
            return None
        bound_s = self.first_s * 2.0 ** min(attempt - 1, _DOUBLINGS)
        return min(asked_s + draw() * bound_s, max(asked_s, self.longest_s))


def retry_after_s(header: str | None, now: Callable[[], datetime] = lambda: datetime.now(UTC)) -> float | None:
    """Parse a Retry-After header, a number of seconds or a date (RFC 9110, 10.2.3). Return None for other texts."""
    if header is None:
        return None
    try:
        seconds = float(header) if header.strip().isdigit() else _until(header, now())
    except (ValueError, OverflowError):
        return None
    return seconds if math.isfinite(seconds) else None


def _until(date: str, now: datetime) -> float:
    return max(0.0, (parsedate_to_datetime(date).astimezone(UTC) - now).total_seconds())
