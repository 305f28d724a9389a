"""Functions with the same bits on every processor."""

import math

import numpy as np

from training.simulation import exact


def test_functions_are_those_of_the_c_library_in_any_shape() -> None:
    """Sine, cosine and arctangent have the bits of ``math``, and the shape of their arguments, empty ones too."""
    x, y = np.random.default_rng(1).normal(0.0, 3.0, (2, 4, 5))

    assert exact.sin(x).tolist() == [[math.sin(value) for value in row] for row in x.tolist()]
    assert exact.cos(x).tolist() == [[math.cos(value) for value in row] for row in x.tolist()]
    pairs = zip(y.ravel().tolist(), x.ravel().tolist(), strict=True)
    assert exact.atan2(y, x).ravel().tolist() == [math.atan2(*pair) for pair in pairs]
    assert exact.sin(np.empty((0, 3))).shape == (0, 3)


def test_strided_arguments_have_the_same_bits() -> None:
    """Columns of a table and their copies give the same values."""
    table = np.random.default_rng(2).normal(0.0, 1.0, (50, 3))

    assert (exact.atan2(table[:, 0], table[:, 2]) == exact.atan2(table[:, 0].copy(), table[:, 2].copy())).all()


def test_directions_are_unit_vectors_and_wrapped_angles_point_alike() -> None:
    """A direction is cosine and sine, and an angle over half a turn wraps to the same direction."""
    angles = np.array([0.0, math.pi / 2, -math.pi, 7.0, -7.0])

    assert np.abs(exact.directions(angles) - np.column_stack([np.cos(angles), np.sin(angles)])).max() < 1e-15
    assert np.abs(exact.wrapped(angles)).max() <= math.pi
    assert np.abs(exact.directions(exact.wrapped(angles)) - exact.directions(angles)).max() < 1e-14
