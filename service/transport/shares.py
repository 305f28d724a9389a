"""Shares: a count that is bounded in sum and per caller, such as that of requests in flight or of bytes in memory.

A caller may take three quarters of the whole, so that no single one can take everything from the others.
"""

from collections import Counter
from collections.abc import Callable

from service.errors import CazslError


def usual_share(limit: int) -> int:
    """Return the share of one caller: three quarters of the limit, and at least 1 unless the limit is 0."""
    return -(-limit * 3 // 4)


class Shares:
    """A count with a limit for all callers, and one for each.

    Attributes:
        total: the count of all callers.
    """

    def __init__(
        self, limit: int, share: int, full: Callable[[int], CazslError], greedy: Callable[[int], CazslError]
    ) -> None:
        """Set the limits.

        Args:
            limit: of all callers together.
            share: of each caller.
            full: makes the error for a caller if there is no room for anyone.
            greedy: makes the error for a caller whose share is used up.
        """
        self._limit = limit
        self._share = share
        self._full = full
        self._greedy = greedy
        self.total = 0
        self._taken: Counter[str] = Counter()

    def check(self, caller: str, count: int = 1) -> None:
        """Check that a caller may take a count.

        Raises:
            CazslError: there is no room, or the caller's share is used up.
        """
        if self.total + count > self._limit:
            raise self._full(self._limit)
        if self._taken[caller] + count > self._share:
            raise self._greedy(self._share)

    def take(self, caller: str, count: int = 1) -> None:
        """Take a count for a caller.

        Raises:
            CazslError: see ``check``. The count is not taken.
        """
        self.check(caller, count)
        self.total += count
        self._taken[caller] += count

    def give(self, caller: str, count: int = 1) -> None:
        """Give a count back."""
        self.total -= count
        self._taken[caller] -= count
        if self._taken[caller] <= 0:
            del self._taken[caller]
