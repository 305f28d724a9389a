"""Transcendental functions whose values do not depend on the processor, for numbers that enter written files.

numpy chooses its own sine, cosine and arctangent by the processor, and they differ in the last bits. The C library's
are the same wherever the library is the same. Additions, products, quotients and square roots are exact by IEEE 754
in numpy too. Products of matrices are not: their order of summation depends on the processor.
"""

import math
from collections.abc import Callable

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


def sin(angles: Array) -> Array:
    """Compute the sines of angles in radians, in any shape."""
    return _mapped(math.sin, angles)


def cos(angles: Array) -> Array:
    """Compute the cosines of angles in radians, in any shape."""
    return _mapped(math.cos, angles)


def atan2(y: Array, x: Array) -> Array:
    """Compute the angles of vectors (x, y) of one shape, in [-pi, pi]."""
    return _mapped(math.atan2, y, x)


def exp(powers: Array) -> Array:
    """Compute the exponentials of numbers in any shape."""
    return _mapped(math.exp, powers)


def directions(angles: Array) -> Array:
    """Compute the unit vectors (..., 2) that point along angles (...) in radians."""
    return np.stack([cos(angles), sin(angles)], axis=-1)


def wrapped(angles: Array) -> Array:
    """Return the same directions in [-pi, pi]."""
    return atan2(sin(angles), cos(angles))


def _mapped(function: Callable[..., float], *arrays: Array) -> Array:
    values = map(function, *(array.ravel().tolist() for array in arrays))
    return np.fromiter(values, dtype=np.float64, count=arrays[0].size).reshape(arrays[0].shape)
