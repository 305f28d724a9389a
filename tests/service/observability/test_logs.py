"""Logs are lines of JSON, and those of requests are written in groups."""

import asyncio
import io
import json
import logging

import pytest

from service.observability.logs import RequestLog, configure_logging
from service.observability.records import RequestRecord


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
        for number in range(1000):
            log.add(RequestRecord("many", "GET", status=number))
        assert len(stream.getvalue().splitlines()) > 500

    asyncio.run(scenario())


def test_events_are_lines_of_json(capfd: pytest.CaptureFixture[str]) -> None:
    """Every event, also of uvicorn, is a line of JSON with level, logger, message and time."""
    before = (logging.root.handlers[:], logging.root.level)
    try:
        configure_logging("INFO")
        logging.getLogger("uvicorn.error").info("started", extra={"color_message": "\x1b[36mstarted"})
        logging.getLogger("service.anything").debug("hidden")
    finally:
        logging.root.handlers[:], logging.root.level = before
    lines = [json.loads(line) for line in capfd.readouterr().err.splitlines()]
    assert [(line["level"], line["logger"], line["message"]) for line in lines] == [
        ("INFO", "uvicorn.error", "started")
    ]
    assert set(lines[0]) == {"level", "logger", "message", "time"}
