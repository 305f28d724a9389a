"""The end of the process, which keeps its time whatever a thread does.

Python awaits threads when it ends: those of ``concurrent.futures`` at exit, and libraries await their own. A thread
that hangs would keep the process for as long. So the process leaves by ``os._exit`` once its last lines are written. A
watch does so in its place if the event loop itself does not end.
"""

import contextlib
import queue
import threading
import time
from collections.abc import Callable


class EndWatch:
    """Watch that calls ``late`` if the process is still there when its time is over."""

    def __init__(self, late: Callable[[], None]) -> None:
        self._late = late
        self._ends_at: queue.SimpleQueue[float] = queue.SimpleQueue()  # may be filled by a handler of signals

    def start(self) -> None:
        """Start the thread of the watch. It has no effect until the end begins."""
        threading.Thread(target=self._watch, name="end", daemon=True).start()

    def end_within(self, limit_s: float) -> None:
        """Begin the end, or bring it forward. A handler of signals may call this."""
        self._ends_at.put(time.monotonic() + limit_s)

    def _watch(self) -> None:
        ends_at = self._ends_at.get()
        while (left_s := ends_at - time.monotonic()) > 0.0:
            with contextlib.suppress(queue.Empty):
                ends_at = min(ends_at, self._ends_at.get(timeout=left_s))
        self._late()


def run_within(limit_s: float, function: Callable[[], object]) -> None:
    """Run a last function in a thread, and await it for at most this time."""
    thread = threading.Thread(target=function, name="last", daemon=True)
    thread.start()
    thread.join(limit_s)
