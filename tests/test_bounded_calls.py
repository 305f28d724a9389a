"""Every way to a prediction asks the runtime in bounded calls, also for the largest valid requests."""

import base64
import io
import json
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from fastapi.testclient import TestClient
from PIL import Image

from service.app import create_app
from service.inference.loaded_models import LoadedModels
from service.model.push_cost import MAX_CONTEXTS, MAX_PUSHES
from service.model.tensors import ContextKind, FloatArray
from service.pushing.contexts import VISUAL_SIZE, ObjectContext
from service.pushing.poses import DoubleArray
from service.schemas.rows import MAX_PUSHES as MOST_PUSHES
from service.settings import Settings
from tests.fakes import FakePredictor, all_fake_models

Request = tuple[str, dict[str, Any]]  # the path, and arguments of a client's post
PUSHERS = np.random.default_rng(0).uniform(-0.1, 0.1, (MOST_PUSHES, 3)).round(3)
DESCRIPTORS = [f"{a}a{b}a{c}a{d}a" for a in "1234" for b in "1234" for c in "1234" for d in "1234"]
VIEWS = 8000


def levels() -> "np.ndarray[Any, np.dtype[np.uint8]]":
    """Return distinct visual contexts, (n, 1024)."""
    found = np.zeros((VIEWS, VISUAL_SIZE**2), dtype=np.uint8)
    found[:, :2] = np.stack(np.divmod(np.arange(VIEWS), 256), axis=1)
    return found


def tensor_request(kind: ContextKind, pushers: DoubleArray, contexts: FloatArray | None) -> Request:
    """Return a request of the Open Inference Protocol, in binary."""
    tensors = {"pusher": pushers.astype(np.float32)} | ({} if contexts is None else {"context": contexts})
    inputs = [
        {"name": name, "datatype": "FP32", "shape": array.shape, "parameters": {"binary_data_size": array.nbytes}}
        for name, array in tensors.items()
    ]
    head = json.dumps({"inputs": inputs}).encode()
    return f"/v2/models/push-{kind}/infer", {
        "content": head + b"".join(array.tobytes() for array in tensors.values()),
        "headers": {"Inference-Header-Content-Length": str(len(head))},
    }


def picture() -> bytes:
    """Return a white picture."""
    buffer = io.BytesIO()
    Image.new("L", (VISUAL_SIZE, VISUAL_SIZE), 255).save(buffer, "PNG")
    return buffer.getvalue()


def batch(pushes: int, contexts: list[dict[str, Any]] | None = None) -> Request:
    """Return a batch of the first pushes."""
    body = {"pushers": PUSHERS[:pushes].tolist()} | ({} if contexts is None else {"contexts": contexts})
    return "/v1/predict/batch", {"json": body}


REQUESTS: dict[str, tuple[ContextKind, int, Callable[[], Request]]] = {
    "batch, none": (ContextKind.NONE, MOST_PUSHES, lambda: batch(MOST_PUSHES)),
    "batch, an object": (ContextKind.INDICATOR, MOST_PUSHES, lambda: batch(MOST_PUSHES, [{"descriptor": "1a2b3c4a"}])),
    "batch, objects": (
        ContextKind.INDICATOR,
        MOST_PUSHES,
        lambda: batch(MOST_PUSHES, [{"descriptor": DESCRIPTORS[n % 256]} for n in range(MOST_PUSHES)]),
    ),
    "batch, views": (
        ContextKind.VISUAL,
        VIEWS,
        lambda: batch(VIEWS, [{"visual": base64.b64encode(view).decode()} for view in levels()]),
    ),
    "batch, supports": (
        ContextKind.SUPPORT,
        3000,
        lambda: batch(
            3000, [{"support": {"pushers": [push], "outcomes": [[0, 0, 0]]}} for push in PUSHERS[:3000].tolist()]
        ),
    ),
    "image": (
        ContextKind.VISUAL,
        MOST_PUSHES,
        lambda: (
            "/v1/predict/image",
            {"files": {"image": picture()}, "data": {"pushers": json.dumps(PUSHERS.tolist())}},
        ),
    ),
    "tensors, none": (ContextKind.NONE, MOST_PUSHES, lambda: tensor_request(ContextKind.NONE, PUSHERS, None)),
    "tensors, indicators": (
        ContextKind.INDICATOR,
        5000,
        lambda: tensor_request(
            ContextKind.INDICATOR,
            PUSHERS[:5000],
            np.stack([ObjectContext.from_descriptor(DESCRIPTORS[n % 256]).indicator() for n in range(5000)]),
        ),
    ),
    "tensors, views": (
        ContextKind.VISUAL,
        2900,
        lambda: tensor_request(
            ContextKind.VISUAL,
            PUSHERS[:2900],
            (levels()[:2900] / np.float32(255.0)).astype(np.float32).reshape(-1, 1, VISUAL_SIZE, VISUAL_SIZE),
        ),
    ),
}


@pytest.fixture(scope="module")
def models(tmp_path_factory: pytest.TempPathFactory) -> LoadedModels:
    """Return fake models of every kind."""
    return all_fake_models(tmp_path_factory.mktemp("models"))[1]


@pytest.fixture(scope="module")
def client(models: LoadedModels) -> Iterator[TestClient]:
    """Return a client of the whole application with its default limits."""
    with TestClient(create_app(Settings(poll_interval_s=3600), models)) as found:
        yield found


@pytest.mark.parametrize(("kind", "pushes", "request_of"), REQUESTS.values(), ids=REQUESTS.keys())
def test_the_largest_requests_are_predicted_in_bounded_calls(
    models: LoadedModels, client: TestClient, kind: ContextKind, pushes: int, request_of: Callable[[], Request]
) -> None:
    """Each call is within the bounds of a piece, together they have every push, and the rows keep their order."""
    predictor = models.snapshot.find_default(kind).predictor
    assert isinstance(predictor, FakePredictor)
    predictor.calls.clear()
    path, arguments = request_of()

    answer = client.post(path, **arguments)

    assert answer.status_code == 200, answer.text[:500]
    body = answer.json()
    mean = np.array(body["mean"] if "mean" in body else body["outputs"][0]["data"]).reshape(-1, 3)
    np.testing.assert_allclose(mean[:, :2], -PUSHERS[:pushes, :2] / 10.0, atol=1e-6)
    assert sum(map(len, predictor.calls)) == pushes
    assert max(map(len, predictor.calls)) <= MAX_PUSHES
    assert max(predictor.contexts, default=0) <= MAX_CONTEXTS
    if kind is ContextKind.VISUAL and pushes != MOST_PUSHES:
        expected = (np.divmod(np.arange(pushes), 256)[0] + np.divmod(np.arange(pushes), 256)[1]) / 255.0
        np.testing.assert_allclose(mean[:, 2], expected, atol=1e-5)
