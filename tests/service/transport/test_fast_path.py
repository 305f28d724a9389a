"""The short way gives the bytes that the long way gives, and leaves everything unusual to it."""

import base64
import gzip
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fastapi.testclient import TestClient
from httpx2 import Response
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from starlette.responses import PlainTextResponse

from service.app import create_app
from service.inference.loaded_models import LoadedModels
from service.observability.logs import RequestLog
from service.observability.metrics import RequestMetrics
from service.observability.telemetry import RequestTelemetry
from service.registry.registry import Registry
from service.schemas.contexts import IMAGE_EXAMPLE
from service.settings import Settings
from service.transport.admission import Intake, IntakeLimits
from service.transport.fast_path import FastPath
from service.transport.keys import Keys
from service.transport.threads import Workers
from tests.fakes import all_fake_models
from tests.questions import ODD, PUSHER, VISUAL, contexts, numbers, pushes, references

PLAIN = {"Content-Type": "application/json"}
LONG = {"Content-Type": "application/json; charset=utf-8"}  # means the same, and is not worth a place in the short way
Served = tuple[Registry, LoadedModels]


@pytest.fixture(scope="module")
def served(tmp_path_factory: pytest.TempPathFactory) -> Served:
    """Fakes of every kind."""
    return all_fake_models(tmp_path_factory.mktemp("models"))


@pytest.fixture(scope="module")
def client(served: Served) -> Iterator[TestClient]:
    """The whole app."""
    app = create_app(Settings(poll_interval_s=3600), served[1])
    with TestClient(app, raise_server_exceptions=False) as found:
        yield found


@pytest.fixture(scope="module")
def short_only(served: Served) -> Iterator[TestClient]:
    """The short way with nothing behind it but a refusal."""
    workers = Workers(1, 8, 10.0)
    fast_path = FastPath(PlainTextResponse("the long way", 418), served[1], workers, Keys(None))
    intake = Intake(fast_path, IntakeLimits(1 << 20, 10.0, 8, 0, 1 << 24))
    yield TestClient(
        RequestTelemetry(intake, PlainTextResponse("internal", 500), RequestLog(), RequestMetrics(lambda *_: True))
    )
    workers.close()


def both_ways(client: TestClient, path: str, content: bytes) -> tuple[Response, Response]:
    """The same request by the short way and by the long one."""
    request_id = {"X-Request-ID": "the-same"}
    short, long = (client.post(path, content=content, headers=kind | request_id) for kind in (PLAIN, LONG))
    assert short.content == long.content
    assert (short.status_code, dict(short.headers)) == (long.status_code, dict(long.headers))
    return short, long


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
def test_a_push_gets_the_same_bytes_both_ways(client: TestClient, body: Any) -> None:
    """Answers and refusals alike, headers too."""
    both_ways(client, "/v1/predict", json.dumps(body).encode())


@alike
@given(batches)
def test_a_batch_gets_the_same_bytes_both_ways(client: TestClient, body: Any) -> None:
    """Answers and refusals alike, headers too."""
    both_ways(client, "/v1/predict/batch", json.dumps(body).encode())


@alike
@given(st.binary(max_size=60), st.integers(0, 200), st.integers(0, 200))
def test_broken_bytes_get_the_same_bytes_both_ways(client: TestClient, noise: bytes, start: int, end: int) -> None:
    """A good body with a piece replaced by noise."""
    good = json.dumps({"pusher": PUSHER, "context": {"descriptor": "1a2b3c4a"}}).encode()
    both_ways(client, "/v1/predict", good[:start] + noise + good[end:])


@pytest.mark.parametrize("name", ODD)
def test_what_parsers_disagree_about_gets_the_same_bytes_both_ways(client: TestClient, name: str) -> None:
    """The two ways have two JSON readers; nothing may show it."""
    both_ways(client, "/v1/predict", ODD[name])


ODD_ROWS = {
    "rows twice": b'{"pushers": [[9, 9, 9]], "pushers": [[0, 0, 0]]}',
    "a truth value": b'{"pushers": [[true, 0, 0]]}',
    "an infinity": b'{"pushers": [[0, 0, 1e999]]}',
    "NaN": b'{"pushers": [[0, 0, NaN]]}',
    "a long integer": b'{"pushers": [[0, 0, ' + b"7" * 300 + b"]]}",
    "an integer beyond float64": b'{"pushers": [[0, 0, ' + b"7" * 400 + b"]]}",
    "a deep list": b'{"pushers": ' + b"[" * 900 + b"]" * 900 + b"}",
    "a deep stranger": b'{"pushers": [[0, 0, 0]], "other": ' + b"[" * 900 + b"]" * 900 + b"}",
    "a number for the index": b'{"pushers": [[0, 0, 0]], "contexts": [{"descriptor": "1a2b3c4a"}], '
    b'"context_index": [18446744073709551616]}',
    "a list": b"[]",
    "bytes behind it": b'{"pushers": [[0, 0, 0]]} \x00',
    "a surrogate": b'{"pushers": [[0, 0, 0]], "model": "\\ud800"}',
}


@pytest.mark.parametrize("name", ODD_ROWS)
def test_rows_that_parsers_disagree_about_get_the_same_bytes_both_ways(client: TestClient, name: str) -> None:
    """The two ways have two JSON readers; nothing may show it."""
    both_ways(client, "/v1/predict/batch", ODD_ROWS[name])


@pytest.mark.parametrize("pushes", [2000, 9000], ids=["read in the loop", "read in a thread"])
def test_a_long_batch_gets_the_same_bytes_both_ways(client: TestClient, pushes: int) -> None:
    """The runtime in a thread, by either way."""
    body = {"pushers": [[number / 1e4, 0.0, number] for number in range(pushes)], "contexts": [{"visual": VISUAL}]}
    short, _ = both_ways(client, "/v1/predict/batch", json.dumps(body).encode())
    assert short.status_code == 200


def test_a_long_inference_gets_the_same_bytes_both_ways(client: TestClient) -> None:
    """The long way inflates what the short way leaves to it."""
    raw = np.linspace(-0.1, 0.1, 3000, dtype=np.float32).tobytes()
    pusher = {"name": "pusher", "shape": [1000, 3], "datatype": "FP32", "parameters": {"binary_data_size": len(raw)}}
    head = json.dumps({"id": "7", "inputs": [pusher], "parameters": {"binary_data_output": True}}).encode()
    headers = {"Inference-Header-Content-Length": str(len(head)), "X-Request-ID": "the-same"}
    path = "/v2/models/push-none/infer"
    short = client.post(path, content=head + raw, headers=headers)
    long = client.post(path, content=gzip.compress(head + raw), headers=headers | {"Content-Encoding": "gzip"})
    assert short.status_code == 200
    assert (short.content, dict(short.headers)) == (long.content, dict(long.headers))


IMAGE = base64.b64decode(IMAGE_EXAMPLE)
PNG = {"Content-Type": "image/png"}
FORM = {"Content-Type": "multipart/form-data; boundary=x"}


def form(image: bytes = IMAGE, **fields: object) -> bytes:
    """The body of a form with an image."""
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
def test_an_upload_gets_the_same_bytes_both_ways(client: TestClient, name: str) -> None:
    """Answers and refusals alike, headers too."""
    path, kind, content, status = UPLOADED[name]
    short, long = (
        client.post(path, content=content, headers={**kind, "X-Request-ID": "the-same", "Accept": accept})
        for accept in ("application/json", "application/json;q=1")  # means the same, and is worth a second look
    )
    assert short.status_code == status, short.text
    assert (short.content, dict(short.headers)) == (long.content, dict(long.headers))


@pytest.mark.parametrize("name", ["an image", "an image in a form", "a push", "pushes in the world", "half an image"])
def test_an_upload_needs_no_framework(short_only: TestClient, name: str) -> None:
    """Nor does an image that is none: it would be decoded twice."""
    path, kind, content, status = UPLOADED[name]
    assert short_only.post(path, content=content, headers=kind).status_code == status


BODY = json.dumps({"pusher": PUSHER}).encode()


def test_a_plain_prediction_needs_no_framework(short_only: TestClient) -> None:
    """Push, batch and inference are answered with nothing behind the short way."""
    tensor = {"name": "pusher", "shape": [1, 3], "datatype": "FP32", "data": [0.1, 0, 0]}
    asked: dict[str, Any] = {
        "/v1/predict": {"pusher": PUSHER},
        "/v1/predict/batch": {"pushers": [[0.1, 0, 0]]},
        "/v2/models/push-none/infer": {"inputs": [tensor]},
        "/v2/models/push-none/versions/1/infer": {"inputs": [tensor]},
    }
    for path, body in asked.items():
        response = short_only.post(path, json=body)
        assert response.status_code == 200, (path, response.text)
        assert response.headers["x-request-id"]


UNUSUAL: dict[str, tuple[str, dict[str, str], bytes]] = {
    "another path": ("/v1/predictions", PLAIN, BODY),
    "no content type": ("/v1/predict", {}, BODY),
    "another accept": ("/v1/predict", PLAIN | {"Accept": "text/html"}, BODY),
    "compressed": ("/v1/predict", PLAIN | {"Content-Encoding": "gzip"}, BODY),
    "a fault": ("/v1/predict", PLAIN, b"{}"),
    "no JSON": ("/v1/predict", PLAIN, b"{"),
    "an unknown model": ("/v1/predict", PLAIN, BODY.replace(b"}}", b'}, "model": "nobody"}')),
    "an unknown version": ("/v2/models/push-none/versions/7/infer", PLAIN, b"{}"),
    "an upload that asks for another answer": ("/v1/contexts", PNG | {"Accept": "image/png"}, IMAGE),
    "an upload without its push": ("/v1/predict/image", PNG, IMAGE),
    "no version": ("/v2/models/push-none/versions/x/infer", PLAIN, b"{}"),
}


@pytest.mark.parametrize("name", UNUSUAL)
def test_what_is_unusual_goes_the_long_way(short_only: TestClient, name: str) -> None:
    """Everything but a plain request that is in order."""
    path, headers, content = UNUSUAL[name]
    assert short_only.post(path, content=content, headers=headers).status_code == 418


def test_other_methods_go_the_long_way(short_only: TestClient) -> None:
    """Only POST predicts."""
    assert short_only.get("/v1/predict").status_code == 418


def test_a_key_is_needed_on_the_short_way_too(served: Served, tmp_path: Path) -> None:
    """Without one the long way is taken, and says so."""
    (tmp_path / "keys").write_text("")
    app = create_app(Settings(keys=tmp_path / "keys", poll_interval_s=3600), served[1])
    with TestClient(app) as client:
        assert client.post("/v1/predict", content=BODY, headers=PLAIN).status_code == 401
