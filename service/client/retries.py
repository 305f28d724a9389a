"""When to ask again: after a 503 only, later each time, never all clients at once, and not before Retry-After.

A prediction changes nothing, so asking twice is always safe; but only a 503 says that asking again is of use.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from email.utils import parsedate_to_datetime
from http import HTTPStatus


@dataclass(frozen=True, slots=True)
class Retries:
    """How often and how soon a client asks again."""

    attempts: int = 4
    """Requests in all, the first included."""
    first_s: float = 0.1
    """Longest pause before the second request, in s; it doubles from one to the next."""
    longest_s: float = 5.0
    """A service that asks for a longer pause than this is not asked again, in s."""

    def pause_s(
        self, attempt: int, status: int, retry_after_s: float | None, draw: Callable[[], float]
    ) -> float | None:
        """How long to wait after this attempt (the first is 1); None: that answer is the last.

        ``draw`` gives a number in [0, 1): spread over the whole pause, clients that failed together come back apart.
        """
        if status != HTTPStatus.SERVICE_UNAVAILABLE or attempt >= self.attempts:
            return None
        asked_s = retry_after_s or 0.0
        if asked_s > self.longest_s:
            return None
        return min(asked_s + draw() * self.first_s * 2.0 ** (attempt - 1), max(asked_s, self.longest_s))


def retry_after_s(header: str | None, now: Callable[[], datetime] = lambda: datetime.now(UTC)) -> float | None:
    """The seconds of a Retry-After header, a number or a date (RFC 9110, 10.2.3); None for anything else."""
    if header is None:
        return None
    try:
        seconds = float(header) if header.strip().isdigit() else _until(header, now())
    except (ValueError, OverflowError):
        return None
    return seconds if math.isfinite(seconds) else None


def _until(date: str, now: datetime) -> float:
    return max(0.0, (parsedate_to_datetime(date).astimezone(UTC) - now).total_seconds())
