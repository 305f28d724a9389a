"""The end of the process, which keeps its time whatever a thread does.

Python awaits threads when it ends: those of ``concurrent.futures`` at exit, and libraries await their own. A thread
that hangs would keep the process for as long. So the process leaves by ``os._exit`` after its last works, each of which
has a limit. A watch does so in its place if the event loop itself does not end in time.
"""

import contextlib
import logging
import os
import queue
import signal
import sys
import threading
import time
import traceback
from collections.abc import Callable, Sequence
from typing import Final, NoReturn

LAST_S: Final = 1.0  # after the running requests, for the last works
FAILED: Final = 1

logger = logging.getLogger(__name__)


class Ending:
    """The end of this process: the time that it may take, and the works that it does last."""

    def __init__(self, last: Sequence[Callable[[], object]]) -> None:
        """Create the end of a process.

        Args:
            last: works of the end, in their order. Each gets an equal part of ``LAST_S``.
        """
        self._last = last
        self._status: int | None = None
        self._ends_at: queue.SimpleQueue[float] = queue.SimpleQueue()  # filled by a handler of signals

    def start(self) -> None:
        """Start the watch. It has no effect until the end begins."""
        threading.Thread(target=self._watch, name="end", daemon=True).start()

    def begin(self, limit_s: float) -> None:
        """Begin the end, or bring it forward: the server ends within this time. A handler of signals may call this."""
        self._ends_at.put(time.monotonic() + limit_s + LAST_S)
        # The kernel ends a process in which a thread never gives up the interpreter lock.
        signal.setitimer(signal.ITIMER_REAL, limit_s + 2.0 * LAST_S)

    def leave(self, status: int) -> NoReturn:
        """Do the last works, and end the process with this exit status. No other thread is awaited."""
        self._status = status
        self._leave(status, LAST_S)

    def _watch(self) -> None:
        ends_at = self._ends_at.get()
        while (left_s := ends_at - time.monotonic()) > 0.0:
            with contextlib.suppress(queue.Empty):
                ends_at = min(ends_at, self._ends_at.get(timeout=left_s))
        if self._status is not None:  # the server has ended in time, and its last works hang
            os._exit(self._status)
        logger.critical("the server did not end in time, and is left", extra={"stacks": _stacks()})
        self._leave(FAILED, LAST_S / 2.0)

    def _leave(self, status: int, limit_s: float) -> NoReturn:
        for work in self._last:
            thread = threading.Thread(target=work, name="last", daemon=True)
            with contextlib.suppress(RuntimeError):  # the machine has no thread left
                thread.start()
                thread.join(limit_s / len(self._last))
        os._exit(status)


def _stacks() -> dict[str, list[str]]:
    """Return the stack of every thread by name, its last call first."""
    frames = sys._current_frames()
    return {
        thread.name: [f"{call.filename}:{call.lineno} {call.name}" for call in reversed(traceback.extract_stack(frame))]
        for thread in threading.enumerate()
        if (frame := frames.get(thread.ident or 0)) is not None
    }
