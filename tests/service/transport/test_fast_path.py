"""The fast path and the routes of the framework give the same bytes, and read each request once."""

import asyncio
import base64
import gzip
import io
import json
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fastapi.testclient import TestClient
from httpx2 import Response
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from starlette.requests import ClientDisconnect
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp

from service.api.open_inference.endpoints import inference_endpoints
from service.api.v1.endpoints import ENDPOINTS, SINGLE
from service.app import create_app
from service.errors import DeadlineError
from service.inference.loaded_models import LoadedModels
from service.inference.query import Answer
from service.observability.logs import RequestLog
from service.observability.metrics import RequestMetrics
from service.observability.telemetry import RequestTelemetry
from service.registry.registry import Registry
from service.schemas.contexts import IMAGE_EXAMPLE
from service.settings import Settings
from service.transport.admission import Admission, AdmissionLimits
from service.transport.callers import Callers
from service.transport.endpoints import Endpoints, HttpRequest
from service.transport.fast_path import FastPath, Shortcut, until_left
from service.transport.keys import Grant, Keys, Scope
from service.transport.problems import problem_response
from service.transport.threads import ThreadPool
from tests.fake_connection import FakeConnection, post
from tests.fakes import NO_KEYS, all_fake_models
from tests.request_strategies import ODD, PUSHER, VISUAL, contexts, numbers, pushes, references

PLAIN = {"Content-Type": "application/json"}
OTHER = {"Content-Type": "application/json; charset=utf-8"}  # means the same
Served = tuple[Registry, LoadedModels]


@pytest.fixture(scope="module")
def served(tmp_path_factory: pytest.TempPathFactory) -> Served:
    """Return a registry of fake models of every kind, with its loaded models."""
    return all_fake_models(tmp_path_factory.mktemp("models"))


LIMITS = AdmissionLimits(1 << 20, 10.0, 8, 0, 1 << 24)


def ringed(app: ASGIApp, keys: Keys | None = None) -> ASGIApp:
    """Put telemetry and admission around an application, without the fast path."""
    log, metrics = RequestLog(io.StringIO()), RequestMetrics(lambda *_: True)
    callers = Callers(keys or Keys(None))
    return RequestTelemetry(Admission(app, LIMITS, callers), problem_response, log, metrics)


@pytest.fixture(scope="module")
def client(served: Served) -> Iterator[TestClient]:
    """Return a client of the whole application."""
    app = create_app(Settings(poll_interval_s=3600), served[1])
    with TestClient(app, raise_server_exceptions=False) as found:
        yield found


@pytest.fixture(scope="module")
def framework(served: Served) -> Iterator[TestClient]:
    """Return a client of the application whose requests pass the routes of the framework instead of the fast path."""
    app = create_app(Settings(poll_interval_s=3600), served[1])
    app.rings = ringed(app.framework)
    with TestClient(app, raise_server_exceptions=False) as found:
        yield found


@pytest.fixture(scope="module")
def fast_path_only(served: Served) -> Iterator[TestClient]:
    """Return a client of the fast path in front of a framework that answers every request with 418."""
    threads = ThreadPool(1, 8, 10.0)
    endpoints = Endpoints((*ENDPOINTS, *inference_endpoints(1 << 20)), served[1], threads)
    yield TestClient(ringed(FastPath(PlainTextResponse("the framework", 418), endpoints)))
    threads.close()


Ways = tuple[TestClient, TestClient]


@pytest.fixture(scope="module")
def ways(client: TestClient, framework: TestClient) -> Ways:
    """Return both ways to an answer: the fast path, and the routes of the framework."""
    return client, framework


def same(ways: Ways, path: str, content: bytes, *kinds: dict[str, str]) -> Response:
    """Send the same request both ways, with each of these headers, and check that all answers are the same."""
    responses = [
        client.post(path, content=content, headers={**kind, "X-Request-ID": "the-same"})
        for client in ways
        for kind in kinds
    ]
    first = responses[0]
    for other in responses[1:]:
        assert other.content == first.content
        assert (other.status_code, dict(other.headers)) == (first.status_code, dict(first.headers))
    return first


def both_ways(ways: Ways, path: str, content: bytes) -> Response:
    """Send JSON both ways, with two content types that mean the same."""
    return same(ways, path, content, PLAIN, OTHER)


rows = st.lists(st.lists(numbers, min_size=2, max_size=4), max_size=4)
batches = st.fixed_dictionaries(
    {"pushers": rows},
    optional={
        "contexts": st.lists(contexts, max_size=4),
        "context_index": st.lists(st.integers(-1, 4), max_size=4),
        "object_poses": rows,
        "model": references,
    },
)
alike = settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None, max_examples=400)


@alike
@given(pushes)
def test_a_push_gets_the_same_bytes_both_ways(ways: Ways, body: Any) -> None:
    """Predictions and refusals of single pushes are the same to the byte, with their headers."""
    both_ways(ways, "/v1/predict", json.dumps(body).encode())


@alike
@given(batches)
def test_a_batch_gets_the_same_bytes_both_ways(ways: Ways, body: Any) -> None:
    """Predictions and refusals of batches are the same to the byte, with their headers."""
    both_ways(ways, "/v1/predict/batch", json.dumps(body).encode())


@alike
@given(st.binary(max_size=60), st.integers(0, 200), st.integers(0, 200))
def test_broken_bytes_get_the_same_bytes_both_ways(ways: Ways, noise: bytes, start: int, end: int) -> None:
    """A body with a piece replaced by noise gets the same answer both ways."""
    good = json.dumps({"pusher": PUSHER, "context": {"descriptor": "1a2b3c4a"}}).encode()
    both_ways(ways, "/v1/predict", good[:start] + noise + good[end:])


@pytest.mark.parametrize("name", ODD)
def test_odd_bodies_get_the_same_bytes_both_ways(ways: Ways, name: str) -> None:
    """JSON about which parsers disagree gets the same answer both ways."""
    both_ways(ways, "/v1/predict", ODD[name])


ODD_ROWS = {
    "rows twice": b'{"pushers": [[9, 9, 9]], "pushers": [[0, 0, 0]]}',
    "a truth value": b'{"pushers": [[true, 0, 0]]}',
    "an infinity": b'{"pushers": [[0, 0, 1e999]]}',
    "NaN": b'{"pushers": [[0, 0, NaN]]}',
    "a long integer": b'{"pushers": [[0, 0, ' + b"7" * 300 + b"]]}",
    "an integer beyond float64": b'{"pushers": [[0, 0, ' + b"7" * 400 + b"]]}",
    "a deep list": b'{"pushers": ' + b"[" * 900 + b"]" * 900 + b"}",
    "a deep unknown field": b'{"pushers": [[0, 0, 0]], "other": ' + b"[" * 900 + b"]" * 900 + b"}",
    "a number for the index": b'{"pushers": [[0, 0, 0]], "contexts": [{"descriptor": "1a2b3c4a"}], '
    b'"context_index": [18446744073709551616]}',
    "a list": b"[]",
    "trailing bytes": b'{"pushers": [[0, 0, 0]]} \x00',
    "a surrogate": b'{"pushers": [[0, 0, 0]], "model": "\\ud800"}',
}


@pytest.mark.parametrize("name", ODD_ROWS)
def test_odd_rows_get_the_same_bytes_both_ways(ways: Ways, name: str) -> None:
    """Batches about which JSON parsers disagree get the same answer both ways."""
    both_ways(ways, "/v1/predict/batch", ODD_ROWS[name])


@pytest.mark.parametrize("pushes", [2000, 9000], ids=["read in the loop", "read in a thread"])
def test_a_long_batch_gets_the_same_bytes_both_ways(ways: Ways, pushes: int) -> None:
    """A batch that the runtime predicts in a thread gets the same answer both ways."""
    body = {"pushers": [[number / 1e4, 0.0, number] for number in range(pushes)], "contexts": [{"visual": VISUAL}]}
    assert both_ways(ways, "/v1/predict/batch", json.dumps(body).encode()).status_code == 200


def test_a_long_inference_gets_the_same_bytes_both_ways(ways: Ways) -> None:
    """A compressed inference body gets the answer of the plain body, both ways."""
    raw = np.linspace(-0.1, 0.1, 3000, dtype=np.float32).tobytes()
    pusher = {"name": "pusher", "shape": [1000, 3], "datatype": "FP32", "parameters": {"binary_data_size": len(raw)}}
    head = json.dumps({"id": "7", "inputs": [pusher], "parameters": {"binary_data_output": True}}).encode()
    headers = {"Inference-Header-Content-Length": str(len(head))}
    path = "/v2/models/push-none/infer"
    plain = same(ways, path, head + raw, headers)
    compressed = same(ways, path, gzip.compress(head + raw), headers | {"Content-Encoding": "gzip"})
    assert plain.status_code == 200
    assert (plain.content, dict(plain.headers)) == (compressed.content, dict(compressed.headers))


IMAGE = base64.b64decode(IMAGE_EXAMPLE)
PNG = {"Content-Type": "image/png"}
FORM = {"Content-Type": "multipart/form-data; boundary=x"}


def form(image: bytes = IMAGE, **fields: object) -> bytes:
    """Build the body of a form with an image."""
    parts = [b'Content-Disposition: form-data; name="image"; filename="v"\r\n\r\n' + image]
    for name, value in fields.items():
        text = value if isinstance(value, str) else json.dumps(value)
        parts.append(f'Content-Disposition: form-data; name="{name}"\r\n\r\n{text}'.encode())
    return b"".join(b"--x\r\n" + part + b"\r\n" for part in parts) + b"--x--\r\n"


UPLOADED: dict[str, tuple[str, dict[str, str], bytes, int]] = {
    "an image": ("/v1/contexts", PNG, IMAGE, 200),
    "an image in a form": ("/v1/contexts", FORM, form(), 200),
    "a push": ("/v1/predict/image", FORM, form(pusher=PUSHER), 200),
    "pushes in the world": (
        "/v1/predict/image",
        FORM,
        form(pushers=[[0, 0, 0], [0.1, 0, 0]], object_poses=[[0.1, 0.2, 3]] * 2),
        200,
    ),
    "no pusher": ("/v1/predict/image", PNG, IMAGE, 422),
    "a push out of reach": ("/v1/predict/image", FORM, form(pusher=PUSHER | {"x": 9}), 422),
    "an unknown model": (
        "/v1/predict/image",
        FORM,
        form(pusher=PUSHER, model="nobody"),
        404,
    ),
    "half an image": ("/v1/contexts", PNG, IMAGE[:60], 422),
    "half an image in a form": ("/v1/predict/image", FORM, form(IMAGE[:60], pusher=PUSHER), 422),
    "no image": ("/v1/contexts", PNG, b"", 415),
    "no form": ("/v1/contexts", FORM, b"--y", 400),
    "another field": ("/v1/contexts", FORM, form(colour="red"), 422),
    "another type": ("/v1/contexts", PLAIN, b"{}", 415),
}


@pytest.mark.parametrize("name", UPLOADED)
def test_an_upload_gets_the_same_bytes_both_ways(ways: Ways, name: str) -> None:
    """Predictions and refusals of uploads are the same to the byte, with their headers."""
    path, kind, content, status = UPLOADED[name]
    accepts = ("application/json", "application/json;q=1")  # which mean the same
    found = same(ways, path, content, *({**kind, "Accept": accept} for accept in accepts))
    assert found.status_code == status, found.text


@pytest.mark.parametrize("name", ["an image", "an image in a form", "a push", "pushes in the world", "half an image"])
def test_an_upload_needs_no_framework(fast_path_only: TestClient, name: str) -> None:
    """The fast path answers uploads, and broken images too: otherwise they would be decoded twice."""
    path, kind, content, status = UPLOADED[name]
    assert fast_path_only.post(path, content=content, headers=kind).status_code == status


BODY = json.dumps({"pusher": PUSHER}).encode()


def test_a_plain_prediction_needs_no_framework(fast_path_only: TestClient) -> None:
    """The fast path alone answers single pushes, batches and inference requests."""
    tensor = {"name": "pusher", "shape": [1, 3], "datatype": "FP32", "data": [0.1, 0, 0]}
    bodies: dict[str, Any] = {
        "/v1/predict": {"pusher": PUSHER},
        "/v1/predict/batch": {"pushers": [[0.1, 0, 0]]},
        "/v2/models/push-none/infer": {"inputs": [tensor]},
        "/v2/models/push-none/versions/1/infer": {"inputs": [tensor]},
    }
    for path, body in bodies.items():
        response = fast_path_only.post(path, json=body)
        assert response.status_code == 200, (path, response.text)
        assert response.headers["x-request-id"]


UNUSUAL: dict[str, tuple[str, dict[str, str], bytes, int]] = {
    "no content type": ("/v1/predict", {}, BODY, 415),
    "another accept": ("/v1/predict", PLAIN | {"Accept": "text/html"}, BODY, 406),
    "compressed": ("/v1/predict", PLAIN | {"Content-Encoding": "gzip"}, BODY, 415),
    "no pusher": ("/v1/predict", PLAIN, b"{}", 422),
    "not JSON": ("/v1/predict", PLAIN, b"{", 400),
    "an unknown model": ("/v1/predict", PLAIN, BODY[:-1] + b', "model": "nobody"}', 404),
    "an unknown version": ("/v2/models/push-none/versions/7/infer", PLAIN, b"{}", 404),
    "an upload with another accept": ("/v1/contexts", PNG | {"Accept": "image/png"}, IMAGE, 406),
    "an upload without its push": ("/v1/predict/image", PNG, IMAGE, 422),
    "not a version": ("/v2/models/push-none/versions/x/infer", PLAIN, b"{}", 400),
}


@pytest.mark.parametrize("name", UNUSUAL)
def test_a_refusal_needs_no_framework_and_is_the_same_both_ways(
    ways: Ways, fast_path_only: TestClient, name: str
) -> None:
    """The fast path refuses requests to endpoints itself, with the bytes of the framework."""
    path, headers, content, status = UNUSUAL[name]
    assert fast_path_only.post(path, content=content, headers=headers).status_code == status
    assert same(ways, path, content, headers).status_code == status


def test_other_paths_go_to_the_framework(fast_path_only: TestClient) -> None:
    """The fast path passes requests to other paths to the framework."""
    assert fast_path_only.post("/v1/predictions", content=BODY, headers=PLAIN).status_code == 418


def test_other_methods_go_to_the_framework(fast_path_only: TestClient) -> None:
    """The fast path passes methods other than POST to the framework."""
    assert fast_path_only.get("/v1/predict").status_code == 418


def test_a_key_is_required_on_the_fast_path_too(served: Served, tmp_path: Path) -> None:
    """The fast path refuses a request without a key if keys are required."""
    (tmp_path / "keys").write_text("")
    app = create_app(Settings(keys=tmp_path / "keys", poll_interval_s=3600), served[1])
    with TestClient(app) as client:
        assert client.post("/v1/predict", content=BODY, headers=PLAIN).status_code == 401


class CountingKeys(Keys):
    """Keys that count their checks."""

    def __init__(self, path: Path | None) -> None:
        super().__init__(path)
        self.checks = 0

    def admit(self, authorization: bytes | None, scope: Scope) -> Grant | None:
        """Count a check, then decide as usual."""
        self.checks += 1
        return super().admit(authorization, scope)


class CountingReader:
    """A reader of single pushes that counts its calls."""

    def __init__(self) -> None:
        self.reads = 0
        self.callers: list[str] = []

    def __call__(self, request: HttpRequest) -> Any:
        """Count a call and note its caller, then read as usual."""
        self.reads += 1
        self.callers.append(request.caller)
        return SINGLE.read(request)


Send = Callable[[LoadedModels, Endpoints, Keys, bytes, dict[str, str]], int]


def send_to_connection(
    _models: LoadedModels, endpoints: Endpoints, keys: Keys, body: bytes, headers: dict[str, str]
) -> int:
    """Send a push on a connection with the shortcut. Return the status of its answer."""
    teapot = PlainTextResponse("the framework", 418)
    admission = Admission(teapot, LIMITS, Callers(keys))
    telemetry = RequestTelemetry(
        admission, problem_response, RequestLog(io.StringIO()), RequestMetrics(lambda *_: True)
    )

    async def run() -> bytes:
        """Send and receive in an event loop."""
        connection = FakeConnection(telemetry, Shortcut(endpoints.at(SINGLE.path), endpoints, admission, telemetry))
        connection.receive(post(SINGLE.path, body, [f"{name}: {value}" for name, value in headers.items()]))
        return await connection.answers(1)

    return int(asyncio.run(run()).split(b" ", 2)[1])


def send_to_fast_path(
    _models: LoadedModels, endpoints: Endpoints, keys: Keys, body: bytes, headers: dict[str, str]
) -> int:
    """Send a push to the fast path. Return the status of its answer."""
    client = TestClient(ringed(FastPath(PlainTextResponse("the framework", 418), endpoints), keys))
    return client.post(SINGLE.path, content=body, headers=headers).status_code


def send_to_framework(
    models: LoadedModels, endpoints: Endpoints, keys: Keys, body: bytes, headers: dict[str, str]
) -> int:
    """Send a push to the route of the framework, which requires keys. Return the status of its answer."""
    app = create_app(Settings(keys=NO_KEYS if keys.wanted else None, poll_interval_s=3600), models)
    app.parts = replace(app.parts, endpoints=endpoints, keys=keys)
    app.rings = ringed(app.framework, keys)
    with TestClient(app) as client:
        return client.post(SINGLE.path, content=body, headers=headers).status_code


WAYS_IN = (send_to_connection, send_to_fast_path, send_to_framework)


@pytest.mark.parametrize("send", WAYS_IN)
@pytest.mark.parametrize(
    ("body", "status"),
    [(BODY, 200), (b"{}", 422), (b"{", 400), (BODY[:-1] + b', "model": "nobody"}', 404)],
    ids=["good", "no pusher", "not JSON", "an unknown model"],
)
def test_a_request_is_read_once_and_its_key_checked_once(
    served: Served, tmp_path: Path, send: Send, body: bytes, status: int
) -> None:
    """On every way in, a request is read exactly once and its key checked exactly once, good or refused."""
    grant, key = Grant.new("robot", frozenset({Scope.PREDICT}))
    (tmp_path / "keys").write_text(grant.line())
    keys, read = CountingKeys(tmp_path / "keys"), CountingReader()
    endpoints = Endpoints([replace(SINGLE, read=read)], served[1], ThreadPool(1, 8, 10.0))
    assert send(served[1], endpoints, keys, body, PLAIN | {"Authorization": f"Bearer {key}"}) == status
    assert (read.reads, keys.checks) == (1, 1)


@pytest.mark.parametrize("send", WAYS_IN)
def test_a_request_without_its_key_is_not_read(served: Served, tmp_path: Path, send: Send) -> None:
    """On every way in, the key is checked exactly once, and a request without it is refused unread."""
    (tmp_path / "keys").write_text("")
    keys, read = CountingKeys(tmp_path / "keys"), CountingReader()
    endpoints = Endpoints([replace(SINGLE, read=read)], served[1], ThreadPool(1, 8, 10.0))
    assert send(served[1], endpoints, keys, BODY, PLAIN) == 401
    assert (read.reads, keys.checks) == (0, 1)


@pytest.mark.parametrize("send", WAYS_IN)
@pytest.mark.parametrize("guarded", [True, False], ids=["with keys", "without keys"])
def test_a_request_names_its_caller(served: Served, tmp_path: Path, send: Send, guarded: bool) -> None:
    """On every way in, the caller is the verified key. Without keys it is the address, and never a header."""
    grant, key = Grant.new("robot", frozenset({Scope.PREDICT}))
    (tmp_path / "keys").write_text(grant.line())
    read = CountingReader()
    endpoints = Endpoints([replace(SINGLE, read=read)], served[1], ThreadPool(1, 8, 10.0))
    keys = CountingKeys(tmp_path / "keys" if guarded else None)
    assert send(served[1], endpoints, keys, BODY, PLAIN | {"Authorization": f"Bearer {key}"}) == 200
    address = "address:192.0.2.1" if send is send_to_connection else "address:testclient"
    assert read.callers == ["key:robot" if guarded else address]


class Line:
    """Messages of a server to an application, the last of which never comes unless the client leaves."""

    def __init__(self, *kinds: str) -> None:
        self.kinds = list(kinds)

    async def receive(self) -> dict[str, Any]:
        """Return the next message, or wait for ever."""
        if not self.kinds:
            await asyncio.Event().wait()
        return {"type": self.kinds.pop(0), "body": b"", "more_body": False}


@pytest.mark.parametrize("kinds", [("http.disconnect",), ("http.request", "http.disconnect")])
def test_work_is_cancelled_once_its_client_has_left(kinds: tuple[str, ...]) -> None:
    """The server may repeat the end of the body before it tells that the client has left."""
    ended: list[str] = []

    async def work() -> Answer:
        """Work without end, until it is cancelled."""
        try:
            await asyncio.Event().wait()
        finally:
            ended.append("cancelled")
        return Answer(b"")

    with pytest.raises(ClientDisconnect):
        asyncio.run(until_left(work(), Line(*kinds).receive))
    assert ended == ["cancelled"]


@pytest.mark.parametrize("kinds", [(), ("http.request",) * 9])
def test_an_answer_is_given_to_a_client_that_stays(kinds: tuple[str, ...]) -> None:
    """A server that repeats the end of the body for ever does not hold the event loop."""

    async def work() -> Answer:
        """Answer after a few iterations of the event loop."""
        await asyncio.sleep(0.01)
        return Answer(b"done")

    assert asyncio.run(until_left(work(), Line(*kinds).receive)).content == b"done"


def test_a_refusal_of_long_work_is_raised() -> None:
    """An error of the work is that of the request."""

    async def work() -> Answer:
        """Refuse."""
        raise DeadlineError(1.0)

    with pytest.raises(DeadlineError):
        asyncio.run(until_left(work(), Line().receive))
