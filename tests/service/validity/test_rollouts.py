"""Warnings of rollouts: pushes that a share of the particles never meets, starts inside, and unfamiliar pushes."""

import numpy as np

from service.validity.codes import WarningCode
from service.validity.rollouts import LIKELY, rollout_warnings


def test_shares_within_the_limit_have_no_warning() -> None:
    """A few particles that miss are the tail of any Gaussian."""
    assert rollout_warnings(np.full((3, 2, 4), LIKELY), by_sequence=True) == ()


def test_each_code_names_the_pushes_of_one_sequence() -> None:
    """Rows are pushes, and the detail is that of the first with its share."""
    shares = np.zeros((3, 1, 4))
    shares[0, 0, [1, 3]] = 0.12, 0.5
    shares[2, 0, 0] = 1.0
    misses, unfamiliar = rollout_warnings(shares, by_sequence=False)
    assert (misses.code, misses.rows) == (WarningCode.NO_CONTACT, (1, 3))
    assert misses.detail.startswith("push 1: ")
    assert "12%" in misses.detail
    assert (unfamiliar.code, unfamiliar.rows) == (WarningCode.UNFAMILIAR_PUSH, (0,))


def test_rows_of_many_sequences_are_sequences() -> None:
    """Pushes behind the end of a short sequence do not count."""
    shares = np.zeros((3, 3, 2))
    shares[:, :, 1] = np.nan
    shares[1, 2, 0] = 0.2
    (found,) = rollout_warnings(shares, by_sequence=True)
    assert (found.code, found.rows) == (WarningCode.STARTS_INSIDE, (2,))
    assert found.detail.startswith("sequence 2, push 0: ")
