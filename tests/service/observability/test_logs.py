"""Logs are lines of JSON, and those of requests are written in groups."""

import asyncio
import io
import json
import logging
import sys
import threading
import warnings

import pytest

from service.observability.log_writer import FAILED, LogWriter
from service.observability.logs import LineHandler, RequestLog, configure_logging, log_uncaught
from service.observability.records import RequestRecord
from tests.fakes import Panic


def test_lines_are_written_in_groups() -> None:
    """Lines are written a moment after the first of a group, or once there are many, one line each."""

    async def scenario() -> None:
        """Run the scenario in an event loop."""
        stream = io.StringIO()
        log = RequestLog(stream)
        log.add(RequestRecord("one", "GET", status=1))
        log.add(RequestRecord("two", "GET", status=2))
        assert stream.getvalue() == ""
        while not stream.getvalue():
            await asyncio.sleep(0.01)
        assert [json.loads(line)["status"] for line in stream.getvalue().splitlines()] == [1, 2]
        for number in range(5000):
            log.add(RequestRecord("many", "GET", status=number))
        log.writer.flush(30)
        assert len(stream.getvalue().splitlines()) > 2000

    asyncio.run(scenario())


def test_events_are_lines_of_json(capfd: pytest.CaptureFixture[str]) -> None:
    """Every event, also of uvicorn, is a line of JSON with level, logger, message and time."""
    before = (logging.root.handlers[:], logging.root.level)
    try:
        writer = LogWriter()
        configure_logging("INFO", writer)
        logging.getLogger("uvicorn.error").info("started", extra={"color_message": "\x1b[36mstarted"})
        logging.getLogger("service.anything").debug("hidden")
        writer.close(30)
    finally:
        logging.root.handlers[:], logging.root.level = before
    lines = [json.loads(line) for line in capfd.readouterr().err.splitlines()]
    assert [(line["level"], line["logger"], line["message"]) for line in lines] == [
        ("INFO", "uvicorn.error", "started")
    ]
    assert set(lines[0]) == {"level", "logger", "message", "time"}


def test_a_record_that_cannot_be_written_reaches_no_request() -> None:
    """A line that cannot be made is counted as dropped, of requests and of events."""

    async def scenario() -> None:
        """Run the scenario in an event loop."""
        log = RequestLog(io.StringIO())
        for _ in range(200):  # the group is full during one of these calls
            log.add(RequestRecord("half a character: \ud800", "GET"))
        log.flush()
        assert log.writer.dropped[FAILED] == 200

    asyncio.run(scenario())
    writer = LogWriter(io.StringIO())
    LineHandler(writer).handle(logging.LogRecord("name", logging.INFO, "path", 1, "%d", ("no number",), None))
    assert writer.dropped[FAILED] == 1


def test_exceptions_without_a_caller_are_lines_too(capfd: pytest.CaptureFixture[str]) -> None:
    """Uncaught exceptions of threads and destructors, and warnings, are lines of the log and not plain text."""

    class Fragile:
        """An object whose destructor fails."""

        def __del__(self) -> None:
            raise ZeroDivisionError("in a destructor")

    def fail() -> None:
        """Fail in a thread."""
        raise Panic("in a thread")

    stream = io.StringIO()
    before = logging.root.handlers[:], logging.root.level
    hooks = threading.excepthook, sys.unraisablehook
    try:
        writer = LogWriter(stream)
        configure_logging("INFO", writer)
        log_uncaught()
        thread = threading.Thread(target=fail)
        thread.start()
        thread.join()
        Fragile()
        with warnings.catch_warnings():
            warnings.simplefilter("always")
            logging.captureWarnings(True)  # after pytest's own catching of warnings
            warnings.warn("a warning", UserWarning, stacklevel=1)
            logging.captureWarnings(False)
        writer.close(30)
    finally:
        logging.captureWarnings(False)
        logging.root.handlers[:], logging.root.level = before
        threading.excepthook, sys.unraisablehook = hooks
    text = stream.getvalue()
    assert all(json.loads(line) for line in text.splitlines())
    assert all(part in text for part in ("Panic: in a thread", "ZeroDivisionError: in a destructor", "a warning"))
    assert capfd.readouterr().err == ""
