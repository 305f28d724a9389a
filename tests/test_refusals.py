"""Refusals: every error of docs/api.md is provoked over a network connection, and compared with its example.

For errors of overload, a fake predictor blocks the requests that are being answered for as long as a test needs.
"""

import base64
import io
import json
import re
import socket
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, contextmanager
from http.client import HTTPResponse
from pathlib import Path
from typing import Any, Protocol

import pytest
from httpx2 import Client
from PIL import Image

from service.connections.framing import MAX_HEADERS, MAX_TARGET_BYTES
from service.connections.head_clock import MAX_HEAD_BYTES
from service.inference.loaded_models import LoadedModels
from service.model.predictor import OnnxPredictor, PredictorFactory
from service.pushing.contexts import ObjectContext
from service.registry.registry import Registry
from service.schemas.contexts import IMAGE_EXAMPLE
from service.transport.endpoints import LIGHT_BYTES, LIGHT_PUSHES
from service.transport.keys import Grant, Scope
from service.transport.threads import threads_beside_the_loop
from tests.documented_api import Json, document, examples_of, listed_errors
from tests.fakes import BUGGY, FAILING, Gate, load_fake, publish_fake
from tests.running_service import PATIENCE_S, ROOT, serve_in_thread

JSON = {"Content-Type": "application/json"}
PUSH = {"pusher": {"x": -0.075, "y": 0.0, "angle": 0.0}}
PLAIN = {**PUSH, "context": {"descriptor": "1a2b3c4a"}}
PREDICT, BATCH, INFER = "/v1/predict", "/v1/predict/batch", "/v2/models/push-indicator/infer"
LARGE = {"pushers": [[-0.075, 0.0, 0.0]] * (LIGHT_PUSHES + 1), "contexts": [PLAIN["context"]]}  # goes to a thread


LIMITS = ("body_too_large", "slow_body", "too_many_requests", "overloaded", "deadline_exceeded")
ROWS = LIGHT_BYTES // 8
INDICATOR = ObjectContext.from_descriptor("1a2b3c4a").indicator().tolist()
LARGE_TENSORS = {
    "inputs": [
        {"name": "pusher", "shape": [ROWS, 3], "datatype": "FP32", "data": [0.0] * 3 * ROWS},
        {"name": "context", "shape": [1, 36], "datatype": "FP32", "data": INDICATOR},
    ]
}


class Situation(Protocol):
    """A service in which the next request gets an error. It may keep files in a folder."""

    __name__: str

    def __call__(self, folder: Path, /) -> AbstractContextManager[Client]:
        """Run the service. Return a client."""
        ...


def encoded(content: bytes) -> Json:
    """Return the body of a push with the object in an image."""
    return {**PUSH, "context": {"image": base64.b64encode(content).decode()}}


def wide_picture() -> bytes:
    """Create an image with more pixels on a side than the limit."""
    buffer = io.BytesIO()
    Image.new("L", (9000, 1)).save(buffer, "PNG")
    return buffer.getvalue()


def fake(folder: Path, load: PredictorFactory = load_fake, model: bytes = b"fine") -> LoadedModels:
    """Load a registry with one fake indicator model."""
    publish_fake(Registry(folder / "models"), model=model)
    models = LoadedModels(Registry(folder / "models"), load)
    models.refresh()
    return models


def shipped() -> LoadedModels:
    """Load the shipped models."""
    models = LoadedModels(Registry(ROOT / "models"), OnnxPredictor)
    models.refresh()
    return models


def small_bodies(_: Path) -> AbstractContextManager[Client]:
    """Serve the shipped models, with a limit of 4 KiB for bodies."""
    return serve_in_thread(shipped(), max_body_bytes=4096)


def no_model(folder: Path) -> AbstractContextManager[Client]:
    """Serve an empty registry."""
    return serve_in_thread(LoadedModels(Registry(folder / "empty"), load_fake))


def failing(folder: Path) -> AbstractContextManager[Client]:
    """Serve a model that fails on every push but that of its self-check."""
    return serve_in_thread(fake(folder, model=FAILING))


def buggy(folder: Path) -> AbstractContextManager[Client]:
    """Serve a model that raises an error outside of the error tree."""
    return serve_in_thread(fake(folder, model=BUGGY))


def short_timeouts(folder: Path) -> AbstractContextManager[Client]:
    """Serve with a timeout of 0.1 s for a head, and of 0.1 s for a body."""
    return serve_in_thread(fake(folder), body_timeout_s=0.1)


def small_memory(folder: Path) -> AbstractContextManager[Client]:
    """Serve with a limit of 1 MiB for the bodies of all requests together."""
    return serve_in_thread(fake(folder), max_held_bytes=1 << 20)


@contextmanager
def key_without_scope(folder: Path) -> Iterator[Client]:
    """Serve with API keys. The client sends a key without the scope of predictions by default."""
    made, key = Grant.new("grafana", frozenset([Scope.METRICS]))
    (folder / "keys").write_text(made.line() + "\n")
    with serve_in_thread(shipped(), keys=folder / "keys") as client:
        client.headers["Authorization"] = f"Bearer {key}"
        yield client


@contextmanager
def blocked(folder: Path, requests: int, **settings: Any) -> Iterator[Client]:
    """Serve while this number of large batches is blocked in the predictor. They are answered after the test."""
    gate = Gate()
    with serve_in_thread(fake(folder, gate.load), **settings) as client, ThreadPoolExecutor(requests or 1) as callers:
        try:
            waiting = [callers.submit(client.post, BATCH, json=LARGE) for _ in range(requests)]
            assert all(gate.reached.acquire(timeout=PATIENCE_S) for _ in waiting)
            yield client
        finally:
            gate.opened.set()
        assert [one.result().status_code for one in waiting] == [200] * requests


def one_request_at_a_time(folder: Path) -> AbstractContextManager[Client]:
    """Serve with a limit of one request in flight, which is reached."""
    return blocked(folder, 1, max_in_flight=1)


def one_request_per_caller(folder: Path) -> AbstractContextManager[Client]:
    """Serve with a limit of one request in flight per caller, which is reached."""
    return blocked(folder, 1, max_in_flight_per_caller=1)


def no_free_thread(folder: Path) -> AbstractContextManager[Client]:
    """Serve with all threads busy and no place to wait."""
    return blocked(folder, threads_beside_the_loop(), max_waiting=0)


def short_deadline(folder: Path) -> AbstractContextManager[Client]:
    """Serve with a deadline of 0.1 s and a predictor that takes longer."""
    return blocked(folder, 0, deadline_s=0.1)


PROVOKED: list[tuple[Situation, str, str, str, Any, dict[str, str]]] = [
    # situation, code, template, path, body, headers
    (small_bodies, "malformed_body", PREDICT, PREDICT, b"{", {}),
    (small_bodies, "unknown_model", PREDICT, PREDICT, {**PLAIN, "model": "push-other"}, {}),
    (small_bodies, "not_acceptable", PREDICT, PREDICT, PLAIN, {"Accept": "text/html"}),
    (small_bodies, "body_too_large", PREDICT, PREDICT, b" " * 5000, {}),
    (small_bodies, "image_too_large", PREDICT, PREDICT, encoded(wide_picture()), {}),
    (small_bodies, "unsupported_media_type", PREDICT, PREDICT, PLAIN, {"Content-Encoding": "gzip"}),
    (small_bodies, "unsupported_image", PREDICT, PREDICT, encoded(b"GIF89a"), {}),
    (small_bodies, "invalid_image", PREDICT, PREDICT, encoded(base64.b64decode(IMAGE_EXAMPLE)[:60]), {}),
    (small_bodies, "invalid_request", PREDICT, PREDICT, {**PUSH, "context": {"descriptor": "9a2b3c4a"}}, {}),
    (small_bodies, "wrong_context_kind", PREDICT, PREDICT, {**PLAIN, "model": "push-visual"}, {}),
    (small_bodies, "unknown_model", "/v1/models/{name}", "/v1/models/push-other", None, {}),
    (small_bodies, "invalid_request", "/v1/models/{name}", "/v1/models/" + "a" * 65, None, {}),
    (small_bodies, "not_acceptable", "/v1/models", "/v1/models", None, {"Accept": "text/html"}),
    (small_bodies, "malformed_body", "/v2/models/{name}/infer", INFER, b"{", {}),
    (small_bodies, "body_too_large", "/v2/models/{name}/infer", INFER, b" " * 5000, {}),
    (small_bodies, "unsupported_media_type", "/v2/models/{name}/infer", INFER, b"{}", {"Content-Encoding": "br"}),
    (small_bodies, "invalid_request", "/v2/models/{name}/infer", INFER, {"inputs": []}, {}),
    (small_bodies, "unknown_model", "/v2/models/{name}", "/v2/models/push-other", None, {}),
    (no_model, "model_not_ready", PREDICT, PREDICT, PLAIN, {}),
    (no_model, "model_not_ready", "/v2/health/ready", "/v2/health/ready", None, {}),
    (failing, "prediction", PREDICT, PREDICT, PLAIN, {}),
    (key_without_scope, "forbidden", PREDICT, PREDICT, PLAIN, {}),
    (key_without_scope, "forbidden", "/v2", "/v2", None, {}),
    (key_without_scope, "missing_key", PREDICT, PREDICT, PLAIN, {"Authorization": ""}),
    (key_without_scope, "missing_key", "/v1/models", "/v1/models", None, {"Authorization": ""}),
    (failing, "prediction", BATCH, BATCH, LARGE, {}),
    (buggy, "internal", PREDICT, PREDICT, PLAIN, {}),
    (buggy, "internal", BATCH, BATCH, LARGE, {}),
    (one_request_per_caller, "too_many_requests", PREDICT, PREDICT, PLAIN, {}),
    (one_request_per_caller, "too_many_requests", "/v1/models", "/v1/models", None, {}),
    (one_request_per_caller, "too_many_requests", "/v2/models/{name}/infer", INFER, b"{}", {}),
    (one_request_at_a_time, "overloaded", PREDICT, PREDICT, PLAIN, {}),
    (one_request_at_a_time, "overloaded", "/v1/models", "/v1/models", None, {}),
    (one_request_at_a_time, "overloaded", "/v2/models/{name}/infer", INFER, b"{}", {}),
    (no_free_thread, "overloaded", BATCH, BATCH, LARGE, {}),
    (small_memory, "overloaded", PREDICT, PREDICT, b" " * (2 << 20), {}),
    (short_deadline, "deadline_exceeded", BATCH, BATCH, LARGE, {}),
    (short_deadline, "deadline_exceeded", "/v2/models/{name}/infer", INFER, LARGE_TENSORS, {}),
]
# Requests that no HTTP client sends: situation, code, template if it has one, bytes
HEAD = b"POST %s HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\n"
RAW_REQUESTS: list[tuple[Situation, str, str, bytes]] = [
    (short_timeouts, "slow_head", "", b"GET /livez HTTP/1.1\r\nX: "),
    (short_timeouts, "slow_body", PREDICT, HEAD % PREDICT.encode() + b"Content-Length: 2\r\n\r\n{"),
    (short_timeouts, "slow_body", "/v2/models/{name}/infer", HEAD % INFER.encode() + b"Content-Length: 2\r\n\r\n{"),
    (short_timeouts, "malformed_request", "", b"predict, please\r\n\r\n"),
    (short_timeouts, "head_too_large", "", b"GET /livez HTTP/1.1\r\nX: " + b"a" * MAX_HEAD_BYTES),
    (short_timeouts, "head_too_large", "", b"GET /livez HTTP/1.1\r\n" + b"a: b\r\n" * (MAX_HEADERS + 1) + b"\r\n"),
    (short_timeouts, "head_too_large", "", b"GET /" + b"a" * MAX_TARGET_BYTES + b" HTTP/1.1\r\nHost: a\r\n\r\n"),
    (short_timeouts, "no_such_route", "", b"GET /v1/other HTTP/1.1\r\nHost: localhost\r\n\r\n"),
    (short_timeouts, "method_not_allowed", "", b"DELETE /v1/models HTTP/1.1\r\nHost: localhost\r\n\r\n"),
]


@pytest.fixture(autouse=True)
def no_exception_escapes(caplog: pytest.LogCaptureFixture) -> Iterator[None]:
    """Check that no exception of the app reaches uvicorn."""
    yield
    assert not [one for one in caplog.get_records("call") if (one.name, one.levelname) == ("uvicorn.error", "ERROR")]


@pytest.mark.parametrize(
    ("situation", "code", "template", "path", "sent", "headers"),
    PROVOKED,
    ids=[f"{one[0].__name__} {one[1]} {one[2]}" for one in PROVOKED],
)
def test_a_provoked_error_is_like_its_example(
    situation: Situation, code: str, template: str, path: str, sent: Any, headers: dict[str, str], tmp_path: Path
) -> None:
    """A provoked error has the status, media type, code, title and fields of its example in the OpenAPI document."""
    with situation(tmp_path) as client:
        content = sent if isinstance(sent, bytes | None) else json.dumps(sent).encode()
        response = client.request("GET" if sent is None else "POST", path, content=content, headers=JSON | headers)
    operation = document()["paths"][template]["get" if sent is None else "post"]
    check(operation, code, response.status_code, response.headers["content-type"], response.json())


@pytest.mark.parametrize(
    ("situation", "code", "template", "sent"), RAW_REQUESTS, ids=[f"{one[1]} {one[2]}" for one in RAW_REQUESTS]
)
def test_an_error_of_raw_bytes_is_like_its_example(
    situation: Situation, code: str, template: str, sent: bytes, tmp_path: Path
) -> None:
    """An error that only raw bytes provoke is like its example, or in the table of errors if it has no operation."""
    with situation(tmp_path) as client, socket.create_connection(("127.0.0.1", client.base_url.port)) as connection:
        connection.sendall(sent)
        response = HTTPResponse(connection)
        response.begin()
        answer = json.load(response)
    operation = document()["paths"][template]["post"] if template else None
    check(operation, code, response.status, response.headers["content-type"], answer)


def check(operation: Json | None, code: str, status: int, media_type: str, answer: Json) -> None:
    """Compare an answer with the example of its code and with the table of errors."""
    protocol = media_type == "application/json"
    if not protocol:
        assert (answer["status"], answer["code"], answer["type"]) == (status, code, f"urn:cazsl:problem:{code}")
    assert (status, code) in listed_errors() or (protocol and (status, code) == (400, "invalid_request"))
    if operation is None:
        return
    (media,) = operation["responses"][str(status)]["content"].items()
    assert media_type == media[0]
    example = examples_of(media[1])[code]["value"]
    assert answer.keys() == example.keys()
    if protocol:  # its errors have no codes: the sentence is compared
        assert code not in LIMITS or without_numbers(answer["error"]) == without_numbers(example["error"])
    else:
        assert (answer["title"], answer["status"]) == (example["title"], example["status"])
        assert [one.keys() for one in answer["errors"]] == [one.keys() for one in example["errors"]]


def without_numbers(text: str) -> str:
    """Replace every number of a sentence by 0."""
    return re.sub(r"\d[\d.]*", "0", text)


def test_every_documented_error_is_provoked() -> None:
    """Every error of the table in docs/api.md is provoked, and every error with an example in the OpenAPI document."""
    provoked = {one[1] for one in PROVOKED} | {one[1] for one in RAW_REQUESTS}
    assert provoked == {code for _, code in listed_errors()}
    assert {name.partition("_")[2] for name in document()["components"]["examples"]} <= provoked


def test_a_batch_after_its_deadline_is_not_computed_again(tmp_path: Path) -> None:
    """A batch that misses its deadline is refused once, counted once, and not computed a second time."""
    gate = Gate()
    with serve_in_thread(fake(tmp_path, gate.load), deadline_s=0.1) as client:
        assert client.post(BATCH, json=LARGE).status_code == 503
        counted = {line for line in client.get("/metrics").text.splitlines() if line.endswith(" 1.0")}
        assert 'cazsl_refusals_total{reason="deadline_exceeded"} 1.0' in counted
        assert any(f'route="{BATCH}"' in line and 'status="503"' in line for line in counted)
        assert gate.reached.acquire(timeout=PATIENCE_S)
        gate.opened.set()
        assert client.post(BATCH, json=LARGE).status_code == 200
        assert gate.reached.acquire(timeout=PATIENCE_S)
        assert not gate.reached.acquire(blocking=False)
