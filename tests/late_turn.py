"""A fake turn of a job whose answer becomes late, or is no longer wanted."""

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext

from service.errors import DeadlineError


class LateTurn:
    """Turn of a job that ends at the pause after some others."""

    def __init__(self, pauses: int) -> None:
        self.left = pauses

    def pause(self, needed_bytes: int) -> None:
        """Count a pause, and end the job at the last one."""
        self.left -= 1
        if self.left < 0:
            raise DeadlineError(1.0)

    def ending(self, end: Callable[[], None]) -> AbstractContextManager[None]:
        """Never end anything from another thread."""
        return nullcontext()
