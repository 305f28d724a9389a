"""Every error that docs/api.md lists is provoked over a real connection, and is what its example shows.

Where an error comes of too much at once, a fake holds what is being answered for as long as that is needed.
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

from service.inference.loaded_models import LoadedModels
from service.model.predictor import OnnxPredictor, PredictorFactory
from service.pushing.contexts import ObjectContext
from service.registry.registry import Registry
from service.schemas.contexts import IMAGE_EXAMPLE
from service.transport.endpoints import LIGHT_BYTES, LIGHT_PUSHES
from service.transport.head_clock import MAX_HEAD_BYTES
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
    """A service in which the next request meets its error; it may keep files in a folder."""

    __name__: str

    def __call__(self, folder: Path, /) -> AbstractContextManager[Client]:
        """A client of it."""
        ...


def encoded(content: bytes) -> Json:
    """A push of the object in an image."""
    return {**PUSH, "context": {"image": base64.b64encode(content).decode()}}


def wide_picture() -> bytes:
    """More pixels on a side than are taken."""
    buffer = io.BytesIO()
    Image.new("L", (9000, 1)).save(buffer, "PNG")
    return buffer.getvalue()


def fake(folder: Path, load: PredictorFactory = load_fake, model: bytes = b"fine") -> LoadedModels:
    """One indicator model."""
    publish_fake(Registry(folder / "models"), model=model)
    models = LoadedModels(Registry(folder / "models"), load)
    models.refresh()
    return models


def shipped() -> LoadedModels:
    """The models that ship."""
    models = LoadedModels(Registry(ROOT / "models"), OnnxPredictor)
    models.refresh()
    return models


def small_bodies(_: Path) -> AbstractContextManager[Client]:
    """The models that ship, and room for small bodies only."""
    return serve_in_thread(shipped(), max_body_bytes=4096)


def no_model(folder: Path) -> AbstractContextManager[Client]:
    """Nothing to predict with."""
    return serve_in_thread(LoadedModels(Registry(folder / "empty"), load_fake))


def failing(folder: Path) -> AbstractContextManager[Client]:
    """A model that fails on every push but its own check."""
    return serve_in_thread(fake(folder, model=FAILING))


def buggy(folder: Path) -> AbstractContextManager[Client]:
    """One in which an error comes up that nobody expects."""
    return serve_in_thread(fake(folder, model=BUGGY))


def impatient(folder: Path) -> AbstractContextManager[Client]:
    """A tenth of a second for a head, and another for a body."""
    return serve_in_thread(fake(folder), body_timeout_s=0.1)


def little_memory(folder: Path) -> AbstractContextManager[Client]:
    """A megabyte for all bodies together."""
    return serve_in_thread(fake(folder), max_held_bytes=1 << 20)


@contextmanager
def other_key(folder: Path) -> Iterator[Client]:
    """A key that covers no prediction, sent with every request that sends none."""
    made, key = Grant.new("grafana", frozenset([Scope.METRICS]))
    (folder / "keys").write_text(made.line() + "\n")
    with serve_in_thread(shipped(), keys=folder / "keys") as client:
        client.headers["Authorization"] = f"Bearer {key}"
        yield client


@contextmanager
def held(folder: Path, requests: int, **settings: Any) -> Iterator[Client]:
    """So many large batches are being answered, and will be once the test is over."""
    gate = Gate()
    with serve_in_thread(fake(folder, gate.load), **settings) as client, ThreadPoolExecutor(requests or 1) as callers:
        try:
            waiting = [callers.submit(client.post, BATCH, json=LARGE) for _ in range(requests)]
            assert all(gate.reached.acquire(timeout=PATIENCE_S) for _ in waiting)
            yield client
        finally:
            gate.opened.set()
        assert [one.result().status_code for one in waiting] == [200] * requests


def one_at_once(folder: Path) -> AbstractContextManager[Client]:
    """One request is being answered, and no more may be."""
    return held(folder, 1, max_in_flight=1)


def one_a_caller(folder: Path) -> AbstractContextManager[Client]:
    """One request of this caller is."""
    return held(folder, 1, max_in_flight_per_caller=1)


def no_thread_left(folder: Path) -> AbstractContextManager[Client]:
    """Every thread has its batch, and none may wait."""
    return held(folder, threads_beside_the_loop(), max_waiting=0)


def short_deadline(folder: Path) -> AbstractContextManager[Client]:
    """What is asked for takes longer than it may."""
    return held(folder, 0, deadline_s=0.1)


PROVOKED: list[tuple[Situation, str, str, str, Any, dict[str, str]]] = [
    # situation, code, template, path, what is sent, headers
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
    (other_key, "forbidden", PREDICT, PREDICT, PLAIN, {}),
    (other_key, "forbidden", "/v2", "/v2", None, {}),
    (other_key, "missing_key", PREDICT, PREDICT, PLAIN, {"Authorization": ""}),
    (other_key, "missing_key", "/v1/models", "/v1/models", None, {"Authorization": ""}),
    (failing, "prediction", BATCH, BATCH, LARGE, {}),
    (buggy, "internal", PREDICT, PREDICT, PLAIN, {}),
    (buggy, "internal", BATCH, BATCH, LARGE, {}),
    (one_a_caller, "too_many_requests", PREDICT, PREDICT, PLAIN, {}),
    (one_a_caller, "too_many_requests", "/v1/models", "/v1/models", None, {}),
    (one_a_caller, "too_many_requests", "/v2/models/{name}/infer", INFER, b"{}", {}),
    (one_at_once, "overloaded", PREDICT, PREDICT, PLAIN, {}),
    (one_at_once, "overloaded", "/v1/models", "/v1/models", None, {}),
    (one_at_once, "overloaded", "/v2/models/{name}/infer", INFER, b"{}", {}),
    (no_thread_left, "overloaded", BATCH, BATCH, LARGE, {}),
    (little_memory, "overloaded", PREDICT, PREDICT, b" " * (2 << 20), {}),
    (short_deadline, "deadline_exceeded", BATCH, BATCH, LARGE, {}),
    (short_deadline, "deadline_exceeded", "/v2/models/{name}/infer", INFER, LARGE_TENSORS, {}),
]
# On the wire, since no client sends such: situation, code, template if it has one, bytes
HEAD = b"POST %s HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\n"
ON_THE_WIRE: list[tuple[Situation, str, str, bytes]] = [
    (impatient, "slow_head", "", b"GET /livez HTTP/1.1\r\nX: "),
    (impatient, "slow_body", PREDICT, HEAD % PREDICT.encode() + b"Content-Length: 2\r\n\r\n{"),
    (impatient, "slow_body", "/v2/models/{name}/infer", HEAD % INFER.encode() + b"Content-Length: 2\r\n\r\n{"),
    (impatient, "malformed_request", "", b"predict, please\r\n\r\n"),
    (impatient, "head_too_large", "", b"GET /livez HTTP/1.1\r\nX: " + b"a" * MAX_HEAD_BYTES),
    (impatient, "no_such_route", "", b"GET /v1/other HTTP/1.1\r\nHost: localhost\r\n\r\n"),
    (impatient, "method_not_allowed", "", b"DELETE /v1/models HTTP/1.1\r\nHost: localhost\r\n\r\n"),
]


@pytest.fixture(autouse=True)
def nothing_escapes(caplog: pytest.LogCaptureFixture) -> Iterator[None]:
    """Whatever is provoked, the server below the app hears of no exception."""
    yield
    assert not [one for one in caplog.get_records("call") if (one.name, one.levelname) == ("uvicorn.error", "ERROR")]


@pytest.mark.parametrize(
    ("situation", "code", "template", "path", "sent", "headers"),
    PROVOKED,
    ids=[f"{one[0].__name__} {one[1]} {one[2]}" for one in PROVOKED],
)
def test_an_error_that_is_provoked_is_what_its_example_shows(
    situation: Situation, code: str, template: str, path: str, sent: Any, headers: dict[str, str], tmp_path: Path
) -> None:
    """Its status, its media type, its code and title, and the fields it has."""
    with situation(tmp_path) as client:
        content = sent if isinstance(sent, bytes | None) else json.dumps(sent).encode()
        response = client.request("GET" if sent is None else "POST", path, content=content, headers=JSON | headers)
    operation = document()["paths"][template]["get" if sent is None else "post"]
    check(operation, code, response.status_code, response.headers["content-type"], response.json())


@pytest.mark.parametrize(
    ("situation", "code", "template", "sent"), ON_THE_WIRE, ids=[f"{one[1]} {one[2]}" for one in ON_THE_WIRE]
)
def test_an_error_on_the_wire_is_what_its_example_shows(
    situation: Situation, code: str, template: str, sent: bytes, tmp_path: Path
) -> None:
    """Likewise; what is no operation of the document has its line in docs/api.md."""
    with situation(tmp_path) as client, socket.create_connection(("127.0.0.1", client.base_url.port)) as connection:
        connection.sendall(sent)
        response = HTTPResponse(connection)
        response.begin()
        answer = json.load(response)
    operation = document()["paths"][template]["post"] if template else None
    check(operation, code, response.status, response.headers["content-type"], answer)


def check(operation: Json | None, code: str, status: int, media_type: str, answer: Json) -> None:
    """Compare an answer with the example of this code, and with the table of errors."""
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
    if protocol:  # which has no codes: the sentence says which it is
        assert code not in LIMITS or without_numbers(answer["error"]) == without_numbers(example["error"])
    else:
        assert (answer["title"], answer["status"]) == (example["title"], example["status"])
        assert [one.keys() for one in answer["errors"]] == [one.keys() for one in example["errors"]]


def without_numbers(text: str) -> str:
    """A sentence about a limit, whatever the limit is."""
    return re.sub(r"\d[\d.]*", "0", text)


def test_every_error_that_is_documented_is_provoked_here() -> None:
    """Those of the table, and those that the document has an example of."""
    provoked = {one[1] for one in PROVOKED} | {one[1] for one in ON_THE_WIRE}
    assert provoked == {code for _, code in listed_errors()}
    assert {name.partition("_")[2] for name in document()["components"]["examples"]} <= provoked


def test_what_was_too_late_is_not_begun_again(tmp_path: Path) -> None:
    """One batch, one thread, one deadline."""
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
