"""The cache of shapes keeps the tensors that were used last, within its bound."""

import numpy as np
import pytest

from service.api.v1.shape_cache import MAX_CACHED, ShapeCache
from service.pushing.outlines import MOST_CORNERS, Outline
from service.pushing.shape_context import ShapeContext
from service.schemas.shapes import ShapeKey
from tests.served_graphs import BOX


def key(number: int) -> ShapeKey:
    """Return the key of a shape."""
    return bytes([number]), None, None, None, None, 0.0


def test_the_shapes_that_were_used_last_are_kept() -> None:
    """Of three shapes in a cache of two, the one that was not asked for again is dropped."""
    cache, tensors = ShapeCache(2), (np.zeros(3, dtype=np.float32),)
    for number in (0, 1):
        cache.put(key(number), tensors)
    assert cache.get(key(0)) is tensors
    cache.put(key(2), tensors)
    assert [key(number) in cache for number in range(3)] == [True, False, True]
    assert cache.get(key(1)) is None


def test_tensors_in_the_cache_cannot_be_changed() -> None:
    """Requests share the tensors, so none may write to them."""
    cache, tensor = ShapeCache(), np.zeros(3, dtype=np.float32)
    cache.put(key(0), (tensor,))
    with pytest.raises(ValueError, match="read-only"):
        tensor[0] = 1.0


def test_the_memory_of_the_cache_is_bounded() -> None:
    """A full cache of shapes with the most corners takes less than 16 MiB."""
    tensors = ShapeContext(Outline(BOX.corners)).tensors()
    assert MAX_CACHED * (16 * MOST_CORNERS + sum(tensor.nbytes for tensor in tensors)) < 16 << 20
