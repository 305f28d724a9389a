"""Turns: long work in a thread pauses between its parts, so that others come in between, and ends when it is late.

The code that works says where it may pause, and calls ``pause`` there. The pool that runs it decides. A context
variable holds the turn of the job. Outside of a pool, as in a command or a test, no turn is set and work never pauses.
"""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from contextvars import ContextVar
from typing import Final, Protocol


class Turn(Protocol):
    """The turn of a job: its right to work until its next pause. ``transport.threads`` implements it."""

    def pause(self, needed_bytes: int) -> None:
        """See ``pause``."""
        ...

    def ending(self, end: Callable[[], None]) -> AbstractContextManager[None]:
        """See ``ending``."""
        ...


TURN: Final[ContextVar[Turn | None]] = ContextVar("turn", default=None)


def pause(needed_bytes: int = 0) -> None:
    """Let other jobs work first, if it is their turn, or if the memory for the next part is not free.

    Args:
        needed_bytes: memory of the part until the next pause, beside that of the whole job.

    Raises:
        DeadlineError: the answer is late or no longer wanted, so the job ends here.
    """
    turn = TURN.get()
    if turn is not None:
        turn.pause(needed_bytes)


@contextmanager
def ending(end: Callable[[], None]) -> Iterator[None]:
    """Call ``end`` from another thread if the answer becomes late, or is no longer wanted, within the block."""
    turn = TURN.get()
    if turn is None:
        yield
        return
    with turn.ending(end):
        yield
