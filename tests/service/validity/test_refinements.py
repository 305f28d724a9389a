"""Warnings of refinements."""

import numpy as np

from service.validity.codes import WarningCode
from service.validity.refinements import refinement_warnings


def test_pushes_that_tell_something_have_no_warning() -> None:
    """One value that is half as uncertain as before is enough."""
    assert refinement_warnings(np.array([1.0, 0.5, 1.0, 1.0, 1.0, 1.0]), [1], 10) == ()


def test_pushes_that_tell_little_are_named() -> None:
    """All values about as uncertain as before: the warning is about all pushes."""
    (warning,) = refinement_warnings(np.full(6, 0.95), [], 2)
    assert (warning.code, warning.rows) == (WarningCode.LITTLE_LEARNT, (0, 1))
    assert "95%" in warning.detail


def test_many_outliers_are_named() -> None:
    """More than three in ten outcomes that no body explains are a fault of frames or outline."""
    (warning,) = refinement_warnings(np.full(6, 0.5), [0, 3], 5)
    assert (warning.code, warning.rows) == (WarningCode.MANY_OUTLIERS, (0, 3))
    assert "2 of 5" in warning.detail
