"""Logs as lines of JSON on standard error. All of them pass through one writer, so no caller waits for the stream."""

import asyncio
import logging
import sys
import threading
from logging.config import dictConfig
from typing import TYPE_CHECKING, Final, TextIO

import orjson
from pythonjsonlogger.core import RESERVED_ATTRS
from pythonjsonlogger.json import JsonFormatter

from service.observability.log_writer import FAILED, LogWriter
from service.observability.records import RequestRecord

if TYPE_CHECKING:
    from sys import UnraisableHookArgs

REQUEST_LOGGER: Final = "service.requests"
_HEAD: Final = {"level": "INFO", "logger": REQUEST_LOGGER, "message": "request"}
_ORJSON: Final = orjson.OPT_UTC_Z | orjson.OPT_APPEND_NEWLINE
_FLUSH_S: Final = 0.2
_ENCODED_LINES: Final = 128  # to encode them holds the event loop for less than a millisecond
_FLUSH_LINES: Final = 2048


class LineHandler(logging.Handler):
    """Handler of events that passes each as a line to the writer of the log."""

    def __init__(self, writer: LogWriter) -> None:
        super().__init__()
        self._writer = writer

    def emit(self, record: logging.LogRecord) -> None:
        """Queue the line of an event. An event that cannot be formatted is counted as dropped."""
        try:
            line = self.format(record)
        except Exception:
            self._writer.drop(1, FAILED)
            return
        self._writer.put(line.encode(errors="backslashreplace") + b"\n")


def configure_logging(level: str, writer: LogWriter) -> None:
    """Log each event as a line of JSON to this writer, those of uvicorn included."""
    dictConfig(
        {
            "version": 1,
            "disable_existing_loggers": False,
            "formatters": {
                "json": {
                    "()": JsonFormatter,
                    "format": "{levelname}{name}{message}",
                    "style": "{",
                    "timestamp": "time",
                    "rename_fields": {"levelname": "level", "name": "logger"},
                    "reserved_attrs": [*RESERVED_ATTRS, "color_message"],  # uvicorn's second form of its message
                }
            },
            "handlers": {"lines": {"()": LineHandler, "writer": writer, "formatter": "json"}},
            "loggers": {"python_multipart": {"level": "ERROR"}},  # it repeats the faults of forms, byte by byte
            "root": {"level": level, "handlers": ["lines"]},
        }
    )


def log_uncaught() -> None:
    """Log exceptions that a thread or a destructor leaves uncaught. Python would write them to standard error."""
    logger = logging.getLogger(__name__)

    def in_thread(found: threading.ExceptHookArgs) -> None:
        """Log the exception that ended a thread."""
        extra = {"name_of_thread": found.thread.name if found.thread else ""}
        logger.error("a thread ended by an exception", extra=extra, exc_info=found.exc_value)

    def in_destructor(found: "UnraisableHookArgs") -> None:
        """Log an exception that has no caller."""
        logger.error("an exception had no caller", exc_info=found.exc_value)

    threading.excepthook = in_thread
    sys.unraisablehook = in_destructor
    logging.captureWarnings(True)


class RequestLog:
    """Log of requests, one line of JSON each. Lines are written in groups: one write costs as much as a prediction.

    Lines that are not written yet are lost when the process is killed. ``flush`` writes them at an orderly end.

    Attributes:
        writer: writer of the lines.
    """

    def __init__(self, out: TextIO | LogWriter | None = None) -> None:
        """Create a log on a writer, or on a stream through a writer of its own. None: standard error."""
        self.writer = out if isinstance(out, LogWriter) else LogWriter(out)
        self._records: list[RequestRecord] = []
        self._lines: list[bytes] = []
        self._is_timed = False

    def add(self, record: RequestRecord) -> None:
        """Take the record of a finished request. Its line is written within a fraction of a second."""
        if not self._is_timed:
            self._is_timed = True
            asyncio.get_running_loop().call_later(_FLUSH_S, self._hand_over)
        self._records.append(record)
        if len(self._records) >= _ENCODED_LINES:
            self._encode()
            if len(self._lines) >= _FLUSH_LINES:
                self._hand_over()

    def flush(self) -> None:
        """Write the lines that are waiting, within a bounded time."""
        self._hand_over()
        self.writer.flush()

    def close(self) -> None:
        """Flush, and end the thread of the writer. Later lines start another one."""
        self._hand_over()
        self.writer.close()

    def _hand_over(self) -> None:
        """Pass the lines that are waiting to the writer. Rarely, because its thread takes the interpreter lock."""
        self._is_timed = False
        self._encode()
        lines, self._lines = self._lines, []
        if lines:
            self.writer.put(b"".join(lines), len(lines))

    def _encode(self) -> None:
        """Encode the records that are waiting."""
        records, self._records = self._records, []
        try:
            self._lines += [orjson.dumps(_HEAD | record.line(), option=_ORJSON) for record in records]
        except Exception:  # a fault of the log must not reach the request
            self.writer.drop(len(records), FAILED)
