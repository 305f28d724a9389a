"""Tests of the client in this process: its answers equal those of a service, byte for byte."""

import asyncio
import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx2
import numpy as np
import pytest
from PIL import Image

from service.client import Client, ProblemError
from service.client.local import InProcess
from service.errors import ModelNotReadyError, RegistryError
from tests.running_service import PATIENCE_S, serve

PUSHER = {"x": -0.075, "y": 0.003, "angle": 0.1}
AHEAD = {"x": -0.04, "y": 0.01, "angle": 0.1}
CONTEXT = {"descriptor": "1a2b3c4a"}
BOX = {"outline": [[0.06, 0.04], [-0.06, 0.04], [-0.06, -0.04], [0.06, -0.04]]}
POSES = np.random.default_rng(0).uniform(-0.1, 0.1, (500, 3)).tolist()
GREY = [[0.5] * 32] * 32


@pytest.fixture(scope="module")
def both(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[httpx2.Client, httpx2.Client]]:
    """Clients of a service process, and of the same registry in this process."""
    folder = tmp_path_factory.mktemp("parity")
    with (
        serve(folder) as (port, _),
        httpx2.Client(base_url=f"http://127.0.0.1:{port}", timeout=PATIENCE_S) as remote,
        httpx2.Client(base_url="http://x", transport=InProcess.over(str(folder / "models"))) as local,
    ):
        yield remote, local


@pytest.fixture(scope="module")
def picture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The file of a top-down view."""
    grey = np.zeros((64, 64), dtype=np.uint8)
    grey[20:44, 18:40] = 128
    path = tmp_path_factory.mktemp("picture") / "view.png"
    Image.fromarray(grey).save(path)
    return path


def test_client_in_this_process_has_no_limit_of_time(project_root: Path) -> None:
    """A prediction in this process takes the time that it takes. The limit of a call is that of a service."""
    with Client.local(str(project_root / "models")) as local:
        assert local._timeout_s == math.inf


GOOD = {
    "one": ("/v1/predict", {"pusher": PUSHER, "context": CONTEXT}),
    "one, by version": ("/v1/predict", {"pusher": PUSHER, "context": CONTEXT, "model": "push-indicator@1"}),
    "one, in the world": ("/v1/predict", {"pusher": PUSHER, "context": CONTEXT, "object_pose": PUSHER}),
    "one, visual": ("/v1/predict", {"pusher": PUSHER, "context": {"visual": GREY}}),
    "batch": ("/v1/predict/batch", {"pushers": POSES, "contexts": [CONTEXT]}),
    "batch, in the world": (
        "/v1/predict/batch",
        {"pushers": POSES, "contexts": [CONTEXT], "object_poses": [[0.0, 0.0, 1.0]]},
    ),
    "a rollout": ("/v1/rollout", {"context": CONTEXT, "object_pose": PUSHER, "pushes": [PUSHER, PUSHER]}),
    "a push map": ("/v1/push-map", {"context": CONTEXT}),
    "a plan": ("/v1/plan", {"context": CONTEXT, "object_pose": PUSHER, "goal": AHEAD, "time_s": 2.0}),
    "a refinement": (
        "/v1/contexts/refine",
        {"context": BOX, "pushers": [[-0.08, 0.02, 0.0], [0.0, 0.07, -1.5]], "outcomes": [[0.02, 0.0, -0.2]] * 2},
    ),
}
BAD = {
    "no JSON": ("/v1/predict", b"{"),
    "no object": ("/v1/predict", b"[]"),
    "nothing": ("/v1/predict", {}),
    "another field": ("/v1/predict", {"pusher": PUSHER, "context": CONTEXT, "colour": "red"}),
    "a text for a number": ("/v1/predict", {"pusher": {**PUSHER, "x": "0"}, "context": CONTEXT}),
    "out of reach": ("/v1/predict", {"pusher": {**PUSHER, "x": 2.0}, "context": CONTEXT}),
    "no such object": ("/v1/predict", {"pusher": PUSHER, "context": {"descriptor": "9z"}}),
    "no such model": ("/v1/predict", {"pusher": PUSHER, "context": CONTEXT, "model": "nobody"}),
    "another kind": ("/v1/predict", {"pusher": PUSHER, "context": CONTEXT, "model": "push-visual"}),
    "short rows": ("/v1/predict/batch", {"pushers": [[0.0, 0.0]]}),
    "too many": ("/v1/predict/batch", {"pushers": [[0.0, 0.0, 0.0]] * 10_001, "contexts": [CONTEXT]}),
    "a rollout without pushes": ("/v1/rollout", {"object_pose": PUSHER}),
    "a push map of a view": ("/v1/push-map", {"context": {"visual": GREY}}),
    "a plan without a goal": ("/v1/plan", {"context": CONTEXT, "object_pose": PUSHER}),
    "a refinement of a view": (
        "/v1/contexts/refine",
        {"context": {"visual": GREY}, "pushers": [[-0.1, 0.0, 0.0]], "outcomes": [[0.0, 0.0, 0.0]]},
    ),
    "contexts that do not fit": ("/v1/predict/batch", {"pushers": POSES, "contexts": [CONTEXT] * 2}),
}


def post(client: httpx2.Client, path: str, document: object) -> httpx2.Response:
    """Send a document as JSON."""
    content = document if isinstance(document, bytes) else json.dumps(document).encode()
    return client.post(path, content=content, headers={"Content-Type": "application/json"})


@pytest.mark.parametrize("name", GOOD)
def test_predictions_are_the_same_bytes(both: tuple[httpx2.Client, httpx2.Client], name: str) -> None:
    """A prediction in this process has the same bytes as that of the service."""
    remote, local = (post(client, *GOOD[name]) for client in both)
    assert remote.status_code == local.status_code == 200
    assert remote.content == local.content


@pytest.mark.parametrize("name", BAD)
def test_problems_are_equal_except_for_the_request_id(both: tuple[httpx2.Client, httpx2.Client], name: str) -> None:
    """A refused request has the same status, code, texts and faults as in the service."""
    remote, local = (post(client, *BAD[name]) for client in both)
    assert remote.status_code == local.status_code >= 400
    assert {**remote.json(), "request_id": ""} == local.json()


@pytest.mark.parametrize("path", ["/v1/models", "/v1/models/push-visual", "/v1/models/push-indicator/versions/1"])
def test_models_are_described_alike(both: tuple[httpx2.Client, httpx2.Client], path: str) -> None:
    """Models and versions have the same description as in the service."""
    remote, local = (client.get(path) for client in both)
    assert remote.json() == local.json()


@pytest.mark.parametrize("fields", [{"pusher": json.dumps(PUSHER)}, {"pushers": json.dumps(POSES)}, {"pushers": "x"}])
def test_images_are_seen_alike(
    both: tuple[httpx2.Client, httpx2.Client], picture: Path, fields: dict[str, str]
) -> None:
    """An image gives the same prediction, context and errors as in the service."""

    def answers(client: httpx2.Client) -> list[dict[str, Any]]:
        files = {"image": picture.read_bytes()}
        predicted = client.post("/v1/predict/image", data=fields, files=files)
        seen = client.post("/v1/contexts", files=files)
        broken = client.post("/v1/contexts", files={"image": b"none"})
        return [{**response.json(), "request_id": ""} for response in (predicted, seen, broken)]

    remote, local = (answers(client) for client in both)
    assert remote == local


def test_unknown_model_or_route_is_a_problem(both: tuple[httpx2.Client, httpx2.Client]) -> None:
    """An unknown model is the problem of the service. A route that only a service has is a problem too."""
    remote, local = (client.get("/v1/models/nobody") for client in both)
    assert {**remote.json(), "request_id": ""} == local.json()
    assert "not answered in process" in both[1].get("/metrics").json()["detail"]


def test_registry_without_a_model_is_refused_at_once(tmp_path: Path) -> None:
    """A registry without models is refused when the client is made, not at the first prediction."""
    with pytest.raises(ModelNotReadyError, match="can be used"):
        Client.local(str(tmp_path))
    with pytest.raises(RegistryError, match="a registry is a folder"):
        Client.local("https://example.org/models")


def test_image_is_read_inside_a_running_event_loop(picture: Path, project_root: Path) -> None:
    """The blocking client reads images inside a running event loop, as in a notebook."""

    async def notebook() -> None:
        """Use the client where a loop is running."""
        with Client.local(str(project_root / "models")) as client:
            assert client.make_context(picture).visual
            assert client.predict_image(picture, [[-0.075, 0.0, 0.0]]).mean.shape == (1, 3)
            with pytest.raises(ProblemError, match="unknown_model"):
                client.predict_image(picture, [[-0.075, 0.0, 0.0]], model="nobody")

    asyncio.run(notebook())
