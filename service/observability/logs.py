"""Logs as JSON lines."""

import asyncio
import sys
from logging.config import dictConfig
from typing import Final, TextIO

import orjson
from pythonjsonlogger.core import RESERVED_ATTRS
from pythonjsonlogger.json import JsonFormatter

_HEAD: Final = {"level": "INFO", "logger": __name__, "message": "request"}
_ORJSON: Final = orjson.OPT_UTC_Z
_FLUSH_S: Final = 0.2
_FLUSH_LINES: Final = 512


def configure_logging(level: str) -> None:
    """One JSON line per event on standard error, uvicorn's own lines included."""
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
            "loggers": {"python_multipart": {"level": "ERROR"}},  # it repeats what is wrong in forms, byte by byte
            "root": {"level": level, "handlers": ["stderr"]},
        }
    )


class RequestLog:
    """A JSON line for every request, written together a few times a second: a write each costs as much as a prediction.

    Lines that are not written yet are lost when the process is killed; ``flush`` writes them at an orderly end.
    """

    def __init__(self, stream: TextIO | None = None) -> None:
        self._stream = stream
        self._lines: list[dict[str, object]] = []

    def add(self, line: dict[str, object]) -> None:
        """Take a line; it is written soon."""
        if not self._lines:
            asyncio.get_running_loop().call_later(_FLUSH_S, self.flush)
        self._lines.append(line)
        if len(self._lines) >= _FLUSH_LINES:
            self.flush()

    def flush(self) -> None:
        """Write what there is."""
        lines, self._lines = self._lines, []
        text = b"\n".join([orjson.dumps(_HEAD | line, option=_ORJSON) for line in lines])
        if lines:
            stream = self._stream or sys.stderr
            stream.write(text.decode() + "\n")
            stream.flush()
