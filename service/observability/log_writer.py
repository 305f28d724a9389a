"""The writer of the log: a bounded queue of lines, and a thread that writes them.

No caller ever waits for the stream, and none gets its errors. A pipe that is not read, a full disk or a closed stream
costs lines. These are counted, and a line says how many are missing as soon as lines can be written again.
"""

import os
import queue
import select
import sys
import threading
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Final, TextIO

import orjson

from service.background.supervision import TaskHealth

QUEUE_BYTES: Final = 4 << 20  # about 15,000 lines of requests
FLUSH_S: Final = 0.3
_LATE_S: Final = 30.0
FULL: Final = "queue_full"
FAILED: Final = "write_failed"


@dataclass(frozen=True, slots=True)
class _Lines:
    text: bytes
    count: int
    dropped_before: int  # lines between these and the lines that were queued before them


class LogWriter:
    """Writer of lines to a stream, in their order.

    Attributes:
        dropped: number of lines that were not written, by cause.
        health: health of the thread. It has work while lines wait.
    """

    def __init__(self, stream: TextIO | None = None, queue_bytes: int = QUEUE_BYTES) -> None:
        """Create a writer. Its thread starts with the first lines.

        Args:
            stream: text stream. None: standard error, as it is when lines are written.
            queue_bytes: bytes that may wait. Lines beyond them are dropped.
        """
        self._stream = stream
        self._limit = queue_bytes
        self._queue: queue.SimpleQueue[_Lines | threading.Event | None] = queue.SimpleQueue()
        self._waiting_bytes = 0
        self._dropped_since = 0  # lines that were dropped since lines were queued
        self._missing = 0  # lines that no written line has reported yet
        self._torn = False
        self._thread: threading.Thread | None = None
        self._lock = threading.RLock()  # a handler of signals may log while its thread holds the lock
        self.dropped: Counter[str] = Counter({FULL: 0, FAILED: 0})
        self.health = TaskHealth("log", _LATE_S)

    def put(self, text: bytes, count: int = 1) -> None:
        """Queue this number of lines, each with its line feed, or drop them if too many bytes wait."""
        with self._lock:
            if self._waiting_bytes + len(text) > self._limit:
                self.drop(count, FULL)
                self._dropped_since += count
                return
            lines = _Lines(text, count, self._dropped_since)
            self._dropped_since = 0
            self._waiting_bytes += len(text)
            self.health.begin()
            self._queue.put(lines)
            self._start()

    def drop(self, count: int, cause: str) -> None:
        """Count lines that are not written."""
        with self._lock:
            self.dropped[cause] += count

    def flush(self, limit_s: float = FLUSH_S) -> None:
        """Wait until the waiting lines are written, but at most this time in s."""
        written = threading.Event()
        with self._lock:
            if not self._waiting_bytes and not self._dropped_since:
                return
            self._queue.put(written)
            self._start()
        written.wait(limit_s)

    def close(self, limit_s: float = FLUSH_S) -> None:
        """Flush, and end the thread. Later lines start another one."""
        self.flush(limit_s)
        with self._lock:
            if self._thread is not None:
                self._queue.put(None)
                self._thread = None

    def _start(self) -> None:
        """Start the thread if none runs. Without one the lines wait for the next call."""
        if self._thread is not None and self._thread.is_alive():
            return
        thread = threading.Thread(target=self._work, name="log", daemon=True)
        try:
            thread.start()
        except RuntimeError:  # the machine has no thread left
            return
        self._thread = thread

    def _work(self) -> None:
        while (work := self._queue.get()) is not None:
            if isinstance(work, threading.Event):
                self._report()
                work.set()
                continue
            self._write(work)
            with self._lock:
                self._waiting_bytes -= len(work.text)
            self._report()

    def _report(self) -> None:
        """Report the lines that are missing at the end, if no lines follow them. Then rest."""
        with self._lock:
            if self._waiting_bytes:
                return
            dropped, self._dropped_since = self._dropped_since, 0
        if dropped:
            self._write(_Lines(b"", 0, dropped))
        with self._lock:
            if not self._waiting_bytes and self.health.error is None:
                self.health.rest()

    def _write(self, lines: _Lines) -> None:
        """Write lines, after a line about those that are missing before them."""
        missing = self._missing + lines.dropped_before
        text = b"".join((b"\n" if self._torn else b"", _report(missing) if missing else b"", lines.text))
        try:
            self._write_all(text)
        except BaseException as error:  # a stream may be anything, and the thread must not end
            self._missing = missing + lines.count
            self.drop(lines.count, FAILED)
            self.health.fail(error)
        else:
            self._missing, self._torn = 0, False
            self.health.succeed()

    def _write_all(self, text: bytes) -> None:
        stream = self._stream or sys.stderr
        try:
            descriptor = stream.fileno()
        except (OSError, ValueError):  # a stream in memory
            stream.write(text.decode())
            stream.flush()
            return
        left = memoryview(text)
        while left:
            try:
                left = left[os.write(descriptor, left) :]
            except BlockingIOError:  # another process has made the pipe non-blocking
                ready = select.poll()
                ready.register(descriptor, select.POLLOUT)
                ready.poll()
            except OSError:
                self._torn = self._torn or len(left) < len(text)
                raise


def _report(missing: int) -> bytes:
    line: Mapping[str, object] = {
        "level": "WARNING",
        "logger": __name__,
        "message": f"{missing} lines dropped",
        "time": datetime.now(UTC),
    }
    return orjson.dumps(line, option=orjson.OPT_UTC_Z | orjson.OPT_APPEND_NEWLINE)
