"""How long the parts of a request took, told by the rooms that do the work to whoever serves the request.

A request's parts travel in a context variable, into the threads that work for it too. Outside of a request, in a
command or a test, nobody listens and nothing is kept.
"""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar, Token
from typing import Final, Literal

Part = Literal["queue", "decode", "inference"]
Parts = list[tuple[Part, float]]
_PARTS: Final[ContextVar[Parts | None]] = ContextVar("parts", default=None)


def listen(parts: Parts) -> Token[Parts | None]:
    """From here on, in this task and the threads that work for it, (part, seconds) are added to this list."""
    return _PARTS.set(parts)


def took(part: Part, seconds: float) -> None:
    """Tell what a part took."""
    parts = _PARTS.get()
    if parts is not None:
        parts.append((part, seconds))


@contextmanager
def timed(part: Part) -> Iterator[None]:
    """Tell what the block took, also when it fails."""
    began = time.perf_counter()
    try:
        yield
    finally:
        took(part, time.perf_counter() - began)
