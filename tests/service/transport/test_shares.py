"""Shares bound a count in sum and per caller."""

import pytest

from service.errors import OverloadedError, TooManyRequestsError
from service.transport.shares import Shares, usual_share


def shares(limit: int) -> Shares:
    """Return shares with the usual share of one caller."""
    return Shares(limit, usual_share(limit), lambda found: OverloadedError(f"{found}"), TooManyRequestsError)


def test_one_caller_cannot_take_everything() -> None:
    """A caller may take three quarters. The rest is for others, until all is taken."""
    found = shares(8)
    found.take("a", 6)
    with pytest.raises(TooManyRequestsError):
        found.take("a")
    found.take("b", 2)
    with pytest.raises(OverloadedError):
        found.take("c")
    assert found.total == 8
    found.give("a")
    found.take("c")
    assert found.total == 8


def test_a_count_that_is_refused_is_not_taken() -> None:
    """Neither limit is touched by a refusal, and all that was given back may be taken again."""
    found = shares(8)
    for _ in range(3):
        for count in (7, 9):
            with pytest.raises((OverloadedError, TooManyRequestsError)):
                found.take("a", count)
        found.take("a", 6)
        found.give("a", 6)
    assert found.total == 0


@pytest.mark.parametrize(("limit", "share"), [(0, 0), (1, 1), (2, 2), (4, 3), (256, 192)])
def test_the_usual_share_is_three_quarters(limit: int, share: int) -> None:
    """A limit of one leaves a share of one."""
    assert usual_share(limit) == share
