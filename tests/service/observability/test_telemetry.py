"""Request ids and the line that every request leaves in the log."""

import asyncio
import io
import json
import logging
from collections.abc import Iterator
from datetime import datetime
from typing import Any

import pytest
from fastapi.testclient import TestClient

from service.app import create_app
from service.inference.loaded_models import LoadedModels
from service.observability.logs import RequestLog, configure_logging
from service.observability.records import RequestRecord
from service.registry.registry import Registry
from service.settings import Settings

BODY = {"pusher": {"x": -0.075, "y": 0.0, "angle": 0.0}, "context": {"descriptor": "1a2b3c4a"}}


def test_a_request_id_is_taken_and_returned(client: TestClient) -> None:
    """What a caller sends comes back, so that both logs can be laid beside each other."""
    response = client.post("/v1/predict", json=BODY, headers={"X-Request-ID": "robot-7.push_12"})
    assert response.headers["x-request-id"] == "robot-7.push_12"


@pytest.mark.parametrize("given", ["", "a b", "x" * 65, '"}\\', "é"], ids=["none", "space", "long", "quotes", "letter"])
def test_an_id_that_is_not_safe_in_a_log_is_replaced(client: TestClient, given: str) -> None:
    """Nothing from the network is written to the log as it came."""
    response = client.get("/livez", headers={b"X-Request-ID": given.encode("latin-1")})
    assert len(response.headers["x-request-id"]) == 32
    assert response.headers["x-request-id"] != given


def test_two_requests_have_two_ids(client: TestClient) -> None:
    """An id that was made is made for one request."""
    assert client.get("/livez").headers["x-request-id"] != client.get("/livez").headers["x-request-id"]


@pytest.fixture
def written() -> io.StringIO:
    """Where the lines of requests go."""
    return io.StringIO()


@pytest.fixture
def logged(served: tuple[Registry, LoadedModels], written: io.StringIO) -> Iterator[TestClient]:
    """The app, writing there; leaving it writes what is not written yet."""
    level = logging.getLogger("service.requests").level
    logging.getLogger("service.requests").setLevel(logging.INFO)
    app = create_app(Settings(poll_interval_s=3600), served[1], RequestLog(written))
    with TestClient(app, raise_server_exceptions=False) as found:
        yield found
    logging.getLogger("service.requests").setLevel(level)


def lines(client: TestClient, written: io.StringIO) -> list[dict[str, Any]]:
    """What was written, once the app has ended in order."""
    client.__exit__()
    return [json.loads(line) for line in written.getvalue().splitlines()]


@pytest.mark.parametrize("content_type", ["application/json", "application/json; charset=utf-8"], ids=["fast", "slow"])
def test_a_request_leaves_one_line_with_its_model(logged: TestClient, written: io.StringIO, content_type: str) -> None:
    """Method, route, status, duration, model and version, and nothing of the body; whichever way it went."""
    headers = {"X-Request-ID": "one", "Content-Type": content_type}
    logged.post("/v1/predict", content=json.dumps(BODY), headers=headers)
    (found,) = lines(logged, written)
    assert datetime.fromisoformat(found.pop("time")).tzinfo is not None
    assert found.pop("duration_ms") >= found.pop("inference_ms") >= 0.0
    assert found == {
        "level": "INFO",
        "logger": "service.requests",
        "message": "request",
        "request_id": "one",
        "method": "POST",
        "route": "/v1/predict",
        "status": 200,
        "model": "push-indicator",
        "version": 1,
        "pushes": 1,
    }


TRACE, SPAN = "4bf92f3577b34da6a3ce929d0e0e4736", "00f067aa0ba902b7"


@pytest.mark.parametrize(
    ("given", "taken"),
    [
        (f"00-{TRACE}-{SPAN}-01", True),
        (f"cc-{TRACE}-{SPAN}-01-what-will-be", True),
        (f"00-{TRACE}-{SPAN}-01-more", False),
        (f"ff-{TRACE}-{SPAN}-01", False),
        (f"00-{'0' * 32}-{SPAN}-01", False),
        (f"00-{TRACE}-{'0' * 16}-01", False),
        (f"00-{TRACE.upper()}-{SPAN}-01", False),
        ("made up", False),
    ],
    ids=["this version", "a later one", "too long", "no version", "no trace", "no span", "capitals", "nonsense"],
)
def test_the_callers_trace_is_logged_when_it_is_one(
    logged: TestClient, written: io.StringIO, given: str, taken: bool
) -> None:
    """W3C Trace Context, by its own rules; anything else is left out, as the standard wants."""
    logged.post("/v1/predict", json=BODY, headers={"traceparent": given})
    (found,) = lines(logged, written)
    assert (found.get("trace_id"), found.get("span_id")) == ((TRACE, SPAN) if taken else (None, None))


def test_a_refusal_is_logged_with_its_code(logged: TestClient, written: io.StringIO) -> None:
    """The log says why without the body."""
    logged.post("/v1/predict", json=BODY | {"model": "nobody"})
    (found,) = lines(logged, written)
    assert (found["status"], found["code"]) == (404, "unknown_model")


def test_a_route_that_does_not_exist_is_logged_without_its_path(logged: TestClient, written: io.StringIO) -> None:
    """Paths come from the network; the log has the route's template only. Health is not logged at all."""
    logged.get("/secret-token-in-a-path")
    logged.get("/livez")
    (found,) = lines(logged, written)
    assert (found["route"], found["status"]) == ("unknown", 404)
    assert "secret-token" not in written.getvalue()


def test_lines_are_written_soon_and_many_at_once() -> None:
    """A moment after the first of them, or when there are many; each is a line of its own."""

    async def scenario() -> None:
        """What happens, in the loop."""
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


def test_logs_are_json_lines(capfd: pytest.CaptureFixture[str]) -> None:
    """Every line parses, uvicorn's included, with level, logger, message and time."""
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
