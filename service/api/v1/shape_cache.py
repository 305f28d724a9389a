"""Cache of shapes that were seen: their tensors by their content, within bounds of number and memory."""

import threading
from collections import OrderedDict
from typing import Final

from service.model.tensors import FloatArray
from service.schemas.shapes import ShapeKey

MAX_CACHED: Final = 1024  # of at most 13 KiB each: 8 KiB of corners, 4.7 KiB of tensors
Tensors = tuple[FloatArray, ...]


class ShapeCache:
    """Tensors of the shapes that were used last. Threads may share it."""

    def __init__(self, most: int = MAX_CACHED) -> None:
        self._most = most
        self._known: OrderedDict[ShapeKey, Tensors] = OrderedDict()
        self._lock = threading.Lock()

    def __contains__(self, key: ShapeKey) -> bool:
        """Return whether the tensors of a shape are known."""
        return key in self._known

    def get(self, key: ShapeKey) -> Tensors | None:
        """Return the tensors of a shape, or None if they are not known."""
        with self._lock:
            found = self._known.get(key)
            if found is not None:
                self._known.move_to_end(key)
            return found

    def put(self, key: ShapeKey, tensors: Tensors) -> None:
        """Keep the tensors of a shape, which become read-only, and drop those that were not used for longest."""
        for tensor in tensors:
            tensor.setflags(write=False)
        with self._lock:
            self._known[key] = tensors
            self._known.move_to_end(key)
            while len(self._known) > self._most:
                self._known.popitem(last=False)
