"""Telemetry gives every request an id and a log line."""

import io
import json
import logging
from collections.abc import Iterator
from datetime import datetime
from typing import Any

import pytest
from fastapi.testclient import TestClient
from starlette.responses import PlainTextResponse
from starlette.types import Receive, Scope, Send

from service.app import create_app
from service.inference.loaded_models import LoadedModels
from service.observability.logs import RequestLog
from service.observability.records import RequestRecord
from service.observability.telemetry import RequestTelemetry
from service.registry.registry import Registry
from service.settings import Settings
from service.transport.problems import problem_response

BODY = {"pusher": {"x": -0.075, "y": 0.0, "angle": 0.0}, "context": {"descriptor": "1a2b3c4a"}}


def test_a_request_id_is_returned(client: TestClient) -> None:
    """The id that a caller sends is in the answer, so that both logs have it."""
    response = client.post("/v1/predict", json=BODY, headers={"X-Request-ID": "robot-7.push_12"})
    assert response.headers["x-request-id"] == "robot-7.push_12"


@pytest.mark.parametrize("given", ["", "a b", "x" * 65, '"}\\', "é"], ids=["none", "space", "long", "quotes", "letter"])
def test_an_id_that_is_not_safe_in_a_log_is_replaced(client: TestClient, given: str) -> None:
    """An id with unusual characters, or too long, is replaced by one of ours, so that it is not logged."""
    response = client.get("/livez", headers={b"X-Request-ID": given.encode("latin-1")})
    assert len(response.headers["x-request-id"]) == 32
    assert response.headers["x-request-id"] != given


def test_two_requests_have_two_ids(client: TestClient) -> None:
    """Two requests without an id get different ids."""
    assert client.get("/livez").headers["x-request-id"] != client.get("/livez").headers["x-request-id"]


@pytest.fixture
def written() -> io.StringIO:
    """Return the stream of the log lines of requests."""
    return io.StringIO()


@pytest.fixture
def logged(served: tuple[Registry, LoadedModels], written: io.StringIO) -> Iterator[TestClient]:
    """Return a client of the application that logs to that stream. The end of the application flushes the log."""
    level = logging.getLogger("service.requests").level
    logging.getLogger("service.requests").setLevel(logging.INFO)
    app = create_app(Settings(poll_interval_s=3600), served[1], RequestLog(written))
    with TestClient(app, raise_server_exceptions=False) as found:
        yield found
    logging.getLogger("service.requests").setLevel(level)


def lines(client: TestClient, written: io.StringIO) -> list[dict[str, Any]]:
    """End the application, and return the log lines."""
    client.__exit__()
    return [json.loads(line) for line in written.getvalue().splitlines()]


@pytest.mark.parametrize(
    "content_type", ["application/json", "application/json; charset=utf-8"], ids=["usual type", "unusual type"]
)
def test_a_request_leaves_one_line_with_its_model(logged: TestClient, written: io.StringIO, content_type: str) -> None:
    """The log line has method, route, status, duration, model and version, and no part of the body."""
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
        (f"cc-{TRACE}-{SPAN}-01-future-field", True),
        (f"00-{TRACE}-{SPAN}-01-more", False),
        (f"ff-{TRACE}-{SPAN}-01", False),
        (f"00-{'0' * 32}-{SPAN}-01", False),
        (f"00-{TRACE}-{'0' * 16}-01", False),
        (f"00-{TRACE.upper()}-{SPAN}-01", False),
        ("made up", False),
    ],
    ids=[
        "this version",
        "a later version",
        "too long",
        "not a version",
        "no trace",
        "no span",
        "capitals",
        "another text",
    ],
)
def test_a_valid_trace_of_the_caller_is_logged(
    logged: TestClient, written: io.StringIO, given: str, taken: bool
) -> None:
    """A traceparent header is logged if it is valid by W3C Trace Context, and dropped otherwise."""
    logged.post("/v1/predict", json=BODY, headers={"traceparent": given})
    (found,) = lines(logged, written)
    assert (found.get("trace_id"), found.get("span_id")) == ((TRACE, SPAN) if taken else (None, None))


def test_a_refusal_is_logged_with_its_code(logged: TestClient, written: io.StringIO) -> None:
    """The log line of a refusal has the code of the problem."""
    logged.post("/v1/predict", json=BODY | {"model": "nobody"})
    (found,) = lines(logged, written)
    assert (found["status"], found["code"]) == (404, "unknown_model")


def test_an_unknown_route_is_logged_without_its_path(logged: TestClient, written: io.StringIO) -> None:
    """The log has templates of routes, never paths from the network. Health routes are not logged."""
    logged.get("/secret-token-in-a-path")
    logged.get("/livez")
    (found,) = lines(logged, written)
    assert (found["route"], found["status"]) == ("unknown", 404)
    assert "secret-token" not in written.getvalue()


class Counter:
    """A counter that keeps the records that it is given."""

    def __init__(self) -> None:
        self.records: list[RequestRecord] = []

    def note(self, record: RequestRecord) -> None:
        """Keep a record."""
        self.records.append(record)


async def fail(scope: Scope, receive: Receive, send: Send) -> None:
    """Raise an exception that is not of our tree."""
    raise ZeroDivisionError("the fake has a bug")


def test_an_unexpected_exception_is_logged_and_answered(caplog: pytest.LogCaptureFixture) -> None:
    """The log has the exception with the request id, the client gets the internal error."""
    counter = Counter()
    telemetry = RequestTelemetry(fail, problem_response, RequestLog(io.StringIO()), counter)
    response = TestClient(telemetry).get("/", headers={"X-Request-ID": "one"})
    assert (response.status_code, response.json()["code"], response.headers["x-request-id"]) == (500, "internal", "one")
    assert "the fake has a bug" in caplog.text
    assert [record.status for record in counter.records] == [500]


def test_timings_of_a_late_thread_are_not_part_of_the_request() -> None:
    """A thread that goes on after its deadline does not change the record of an answered request."""
    counter = Counter()
    app = PlainTextResponse("fine")
    telemetry = RequestTelemetry(app, problem_response, RequestLog(io.StringIO()), counter)
    record = telemetry.begin({"headers": [], "method": "POST"})
    timings = record.timings
    timings.append(("queue", 1.0))
    telemetry.end(record, 2.0)
    timings.append(("inference", 3.0))
    assert counter.records[0].timings == [("queue", 1.0)]
