"""Logs as lines of JSON on standard error."""

import asyncio
import sys
from logging.config import dictConfig
from typing import Final, TextIO

import orjson
from pythonjsonlogger.core import RESERVED_ATTRS
from pythonjsonlogger.json import JsonFormatter

from service.observability.records import RequestRecord

REQUEST_LOGGER: Final = "service.requests"
_HEAD: Final = {"level": "INFO", "logger": REQUEST_LOGGER, "message": "request"}
_ORJSON: Final = orjson.OPT_UTC_Z
_FLUSH_S: Final = 0.2
_FLUSH_LINES: Final = 128  # holds the event loop for less than a millisecond


def configure_logging(level: str) -> None:
    """Log each event as a line of JSON on standard error, those of uvicorn included."""
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
            "handlers": {"stderr": {"class": "logging.StreamHandler", "formatter": "json"}},
            "loggers": {"python_multipart": {"level": "ERROR"}},  # it repeats the faults of forms, byte by byte
            "root": {"level": level, "handlers": ["stderr"]},
        }
    )


class RequestLog:
    """Log of requests, one line of JSON each. Lines are written in groups: one write costs as much as a prediction.

    Lines that are not written yet are lost when the process is killed. ``flush`` writes them at an orderly end.
    """

    def __init__(self, stream: TextIO | None = None) -> None:
        self._stream = stream
        self._records: list[RequestRecord] = []

    def add(self, record: RequestRecord) -> None:
        """Take the record of a finished request. Its line is written within a fraction of a second."""
        if not self._records:
            asyncio.get_running_loop().call_later(_FLUSH_S, self.flush)
        self._records.append(record)
        if len(self._records) >= _FLUSH_LINES:
            self.flush()

    def flush(self) -> None:
        """Write the lines that are waiting."""
        records, self._records = self._records, []
        if not records:
            return
        text = b"\n".join([orjson.dumps(_HEAD | record.line(), option=_ORJSON) for record in records])
        stream = self._stream or sys.stderr
        stream.write(text.decode() + "\n")
        stream.flush()
