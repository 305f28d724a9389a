"""Request ids and the line that every request leaves in the log."""

import json
import logging

import pytest
from fastapi.testclient import TestClient

from service.telemetry import configure_logging

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


def test_a_request_leaves_one_line_with_its_model(client: TestClient, caplog: pytest.LogCaptureFixture) -> None:
    """Method, route, status, duration, model and version, and nothing of the body."""
    with caplog.at_level(logging.INFO, logger="service.telemetry"):
        client.post("/v1/predict", json=BODY, headers={"X-Request-ID": "one"})
    (line,) = [record for record in caplog.records if record.name == "service.telemetry"]
    found = vars(line)
    assert (found["request_id"], found["method"], found["route"], found["status"]) == (
        "one",
        "POST",
        "/v1/predict",
        200,
    )
    assert (found["model"], found["version"]) == ("push-indicator", 1)
    assert found["duration_ms"] >= 0.0
    assert "1a2b3c4a" not in str(found)


def test_a_route_that_does_not_exist_is_logged_without_its_path(
    client: TestClient, caplog: pytest.LogCaptureFixture
) -> None:
    """Paths come from the network; the log has the route's template only."""
    with caplog.at_level(logging.INFO, logger="service.telemetry"):
        client.get("/secret-token-in-a-path")
    (line,) = [record for record in caplog.records if record.name == "service.telemetry"]
    assert "secret-token" not in str(vars(line))


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
