"""Requests to ``/v1``, and checks of their answers."""

import json
from typing import Any

from fastapi.testclient import TestClient
from httpx2 import Response

PUSHER = {"x": -0.075, "y": 0.0, "angle": 0.0}
CONTEXT = {"descriptor": "1a2b3c4a"}
JSON = {"Content-Type": "application/json"}


def predict(client: TestClient, body: Any) -> Response:
    """Send a document for one push."""
    return send(client, json.dumps(body))


def send(client: TestClient, content: bytes | str, headers: dict[str, str] = JSON) -> Response:
    """Send bytes for one push."""
    return client.post("/v1/predict", content=content, headers=headers)


def answer(client: TestClient, path: str, body: Any) -> Any:
    """Send a valid request, and return the document of its answer."""
    response = client.post(path, json=body)
    assert response.status_code == 200, response.text
    return response.json()


def batch(client: TestClient, **body: Any) -> Any:
    """Send a valid batch, and return the document of its answer."""
    return answer(client, "/v1/predict/batch", body)


def single(client: TestClient, pusher: list[float], descriptor: str) -> Any:
    """Send a valid push, and return the document of its answer."""
    body = {"pusher": dict(zip(("x", "y", "angle"), pusher, strict=True)), "context": {"descriptor": descriptor}}
    return answer(client, "/v1/predict", body)


def problem(response: Response, status: int, code: str) -> dict[str, Any]:
    """Return the document of a problem, and check its form, status and code."""
    assert response.headers["content-type"] == "application/problem+json"
    document: dict[str, Any] = response.json()
    assert (response.status_code, document["status"], document["code"]) == (status, status, code), document
    assert document["request_id"] == response.headers["x-request-id"]
    assert document["type"].endswith(code)
    assert set(document) == {"type", "title", "status", "code", "detail", "errors", "request_id"}
    return document


def fault(response: Response) -> tuple[str, str]:
    """Return the field and the received value of the only fault of a problem."""
    assert response.status_code == 422, response.text
    (found,) = response.json()["errors"]
    return found["where"], found["received"]
