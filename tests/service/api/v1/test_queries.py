"""Batches, frames and forms of context: what every way in promises."""

import base64
import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fastapi.testclient import TestClient
from httpx2 import Response
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from service.app import create_app
from service.inference.loaded_models import LoadedModels
from service.model.predictor import OnnxPredictor
from service.model.tensors import ContextKind
from service.pushing.contexts import ObjectContext
from service.registry.registry import Registry
from service.schemas.predictions import BatchResponse, PredictResponse
from service.settings import Settings
from tests.fakes import fake_models, publish_fake

DESCRIPTORS = ("1a2b3c4a", "4a4a4a4a", "2B1c3a4b", "3c3a3a3b")
INDICATOR = ObjectContext.from_descriptor("1a2b3c4a").indicator().astype(int).tolist()
LEVELS = bytes(range(256)) * 4

pushers = st.tuples(st.floats(-0.2, 0.2), st.floats(-0.2, 0.2), st.floats(-7.0, 7.0)).map(list)
batches = st.lists(st.tuples(pushers, st.integers(0, len(DESCRIPTORS) - 1)), min_size=1, max_size=12)
no_reset = settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None, max_examples=60)


@pytest.fixture(scope="module")
def shipped(project_root: Path) -> Iterator[TestClient]:
    """The app over the models that ship."""
    models = LoadedModels(Registry(project_root / "models"), OnnxPredictor)
    with TestClient(create_app(Settings(poll_interval_s=3600), models), raise_server_exceptions=False) as found:
        yield found


@pytest.fixture(scope="module")
def faked(tmp_path_factory: pytest.TempPathFactory) -> Iterator[TestClient]:
    """The app over fakes, a visual one among them."""
    registry, models = fake_models(tmp_path_factory.mktemp("models"))
    publish_fake(registry, "push-visual", ContextKind.VISUAL)
    models.refresh()
    with TestClient(create_app(Settings(poll_interval_s=3600), models), raise_server_exceptions=False) as found:
        yield found


def ask(client: TestClient, path: str, body: Any) -> Any:
    """The answer to a request that is in order."""
    response = client.post(path, json=body)
    assert response.status_code == 200, response.text
    return response.json()


def batch(client: TestClient, **body: Any) -> Any:
    """The answer to a batch."""
    return ask(client, "/v1/predict/batch", body)


def fault(response: Response) -> tuple[str, str]:
    """Where the one fault is and what came."""
    assert response.status_code == 422, response.text
    (found,) = response.json()["errors"]
    return found["where"], found["received"]


def single(client: TestClient, pusher: list[float], descriptor: str) -> Any:
    """The answer to one push."""
    body = {"pusher": dict(zip(("x", "y", "angle"), pusher, strict=True)), "context": {"descriptor": descriptor}}
    return ask(client, "/v1/predict", body)


@no_reset
@given(batches)
def test_a_row_does_not_depend_on_the_rows_beside_it(shipped: TestClient, rows: list[tuple[list[float], int]]) -> None:
    """With the real runtime and model: each row of a mixed batch is what the push gets alone.

    Within 2e-6: the runtime's matrix products round by the size of the batch.
    """
    answer = batch(
        shipped,
        pushers=[pusher for pusher, _ in rows],
        contexts=[{"descriptor": descriptor} for descriptor in DESCRIPTORS],
        context_index=[place for _, place in rows],
    )
    for number, (pusher, place) in enumerate(rows):
        alone = single(shipped, pusher, DESCRIPTORS[place])
        difference = np.array(answer["mean"][number]) - list(alone["mean"].values())
        difference[2] = math.remainder(difference[2], 2 * math.pi)
        assert np.abs(difference).max() < 2e-6
        assert answer["std"][number] == pytest.approx(list(alone["std"].values()), rel=1e-5)


@no_reset
@given(batches, st.integers(-1000, 1000))
def test_an_angle_is_circular_in_every_row(
    shipped: TestClient, rows: list[tuple[list[float], int]], turns: int
) -> None:
    """Whole turns change nothing but rounding, and answers lie in (-pi, pi]."""
    here = [pusher for pusher, _ in rows]
    there = [[x, y, angle + turns * 2 * math.pi] for x, y, angle in here]
    contexts = [{"descriptor": DESCRIPTORS[place]} for _, place in rows]
    first, second = batch(shipped, pushers=here, contexts=contexts), batch(shipped, pushers=there, contexts=contexts)
    assert np.array(second["mean"])[:, :2] == pytest.approx(np.array(first["mean"])[:, :2], abs=1e-5)
    angles = np.array([first["mean"], second["mean"]])[:, :, 2]
    assert np.cos(angles[0] - angles[1]) == pytest.approx(1.0, abs=1e-6)
    assert (np.abs(angles) <= math.pi).all()


@no_reset
@given(pushers, st.tuples(st.floats(-50, 50), st.floats(-50, 50), st.floats(-7, 7)))
def test_the_world_frame_is_the_object_frame_seen_from_the_world(
    shipped: TestClient, pusher: list[float], pose: tuple[float, float, float]
) -> None:
    """The object anywhere in the world, pushed alike, ends alike; the covariance is turned with it."""
    x, y, theta = pose
    cos, sin = math.cos(theta), math.sin(theta)
    world = [x + cos * pusher[0] - sin * pusher[1], y + sin * pusher[0] + cos * pusher[1], pusher[2] + theta]
    inside = single(shipped, pusher, "1a2b3c4a")
    body = {
        "pusher": dict(zip(("x", "y", "angle"), world, strict=True)),
        "context": {"descriptor": "1a2b3c4a"},
        "object_pose": {"x": x, "y": y, "angle": theta},
    }
    outside = ask(shipped, "/v1/predict", body)
    assert (inside["frame"], outside["frame"]) == ("object", "world")
    assert "covariance" not in inside
    mean, std = inside["mean"], inside["std"]
    assert outside["mean"]["x"] == pytest.approx(x + cos * mean["x"] - sin * mean["y"], abs=1e-5)
    assert outside["mean"]["y"] == pytest.approx(y + sin * mean["x"] + cos * mean["y"], abs=1e-5)
    assert math.cos(outside["mean"]["angle"] - mean["angle"] - theta) == pytest.approx(1.0, abs=1e-6)
    turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    expected = turn @ np.diag(np.square(list(std.values()))) @ turn.T
    assert np.array(outside["covariance"]) == pytest.approx(expected, rel=1e-3, abs=1e-9)
    assert np.square(list(outside["std"].values())) == pytest.approx(np.diag(outside["covariance"]))


def test_a_batch_in_the_world_answers_each_row_as_alone(shipped: TestClient) -> None:
    """One pose of the object for all, or one per push."""
    context, world = {"descriptor": "2B1c3a4b"}, [[0.4, 0.1, 1.5], [-3.0, 2.0, -0.4]]
    rows = [[0.4, 0.03, 1.4], [-3.05, 2.0, -0.2]]
    answer = batch(shipped, pushers=rows, contexts=[context], object_poses=world)
    assert answer["frame"] == "world"
    for number, (row, pose) in enumerate(zip(rows, world, strict=True)):
        names = ("x", "y", "angle")
        body = {
            "pusher": dict(zip(names, row, strict=True)),
            "context": context,
            "object_pose": dict(zip(names, pose, strict=True)),
        }
        alone = ask(shipped, "/v1/predict", body)
        assert answer["mean"][number] == pytest.approx(list(alone["mean"].values()), abs=2e-6)
        assert np.array(answer["covariance"][number]) == pytest.approx(np.array(alone["covariance"]), rel=1e-4)
    same = batch(shipped, pushers=rows[:1] * 3, contexts=[context], object_poses=world[:1])
    assert same["mean"] == [pytest.approx(answer["mean"][0], abs=2e-6)] * 3


def test_ten_thousand_pushes_are_answered_and_one_more_is_refused(shipped: TestClient) -> None:
    """The stated bound, at the bound and one over it."""
    rows = [[-0.075, 0.0, 0.0]] * 10_000
    answer = batch(shipped, pushers=rows, contexts=[{"descriptor": "1a2b3c4a"}])
    assert len(answer["mean"]) == len(answer["std"]) == 10_000
    assert answer["model"]["name"] == "push-indicator"
    body = {"pushers": [*rows, rows[0]], "contexts": [{"descriptor": "1a2b3c4a"}]}
    assert fault(shipped.post("/v1/predict/batch", json=body))[0] == "body.pushers"


def test_contexts_are_one_for_all_one_per_push_or_by_index(faked: TestClient) -> None:
    """The three ways to say which object a push meets give the same numbers."""
    rows = [[0.1, 0.0, 0.0], [0.2, 0.0, 0.0]]
    context = {"descriptor": "1a2b3c4a"}
    answers = [
        batch(faked, pushers=rows, contexts=[context]),
        batch(faked, pushers=rows, contexts=[context, {"indicator": INDICATOR}]),
        batch(faked, pushers=rows, contexts=[{"descriptor": "4a4a4a4a"}, context, context], context_index=[2, 1]),
    ]
    assert answers[0] == answers[1] == answers[2]
    assert [row[0] for row in answers[0]["mean"]] == pytest.approx([-0.01, -0.02])


def test_without_contexts_the_model_that_needs_none_answers_a_batch(faked: TestClient) -> None:
    """As for one push."""
    assert batch(faked, pushers=[[0.1, 0.0, 0.0]])["model"]["name"] == "push-none"


def test_a_visual_context_is_base64_or_rows_of_numbers(faked: TestClient) -> None:
    """Both are the same 1,024 levels, for one push and in a batch."""
    text = base64.b64encode(LEVELS).decode()
    numbers = [[level / 255 for level in LEVELS[row * 32 : row * 32 + 32]] for row in range(32)]
    pusher = {"x": 0.1, "y": 0.0, "angle": 0.0}
    by_text = ask(faked, "/v1/predict", {"pusher": pusher, "context": {"visual": text}})
    by_numbers = ask(faked, "/v1/predict", {"pusher": pusher, "context": {"visual": numbers}})
    assert by_text == by_numbers
    assert by_text["model"]["name"] == "push-visual"
    many = batch(faked, pushers=[[0.1, 0.0, 0.0]] * 2, contexts=[{"visual": text}, {"visual": numbers}])
    assert many["mean"] == [pytest.approx(list(by_text["mean"].values()))] * 2


def test_models_are_asked_side_by_side(faked: TestClient) -> None:
    """Each request names its own."""
    for reference, name in (("push-none", "push-none"), ("push-none@1", "push-none")):
        assert batch(faked, pushers=[[0.1, 0.0, 0.0]], model=reference)["model"]["name"] == name
    contexts = [{"descriptor": "1a2b3c4a"}]
    assert batch(faked, pushers=[[0.1, 0, 0]], contexts=contexts, model="push-indicator@champion")


FAULTS: dict[str, tuple[dict[str, Any], str, str]] = {
    "no rows": ({"pushers": []}, "body.pushers", "0 values"),
    "a short row": ({"pushers": [[0.0, 0.0, 0.0], [0.0, 0.0]]}, "body.pushers.1", "2 values"),
    "text in a row": ({"pushers": [[0.0, "0", 0.0]]}, "body.pushers.0.1", "a text of 1 characters"),
    "out of reach": ({"pushers": [[0.0, 0.0, 0.0], [0.0, -1.5, 0.0]]}, "body.pushers.1", "-1.5 m"),
    "no contexts": ({"contexts": []}, "body.contexts", "0 values"),
    "contexts that do not fit": (
        {"contexts": [{"descriptor": "4a4a4a4a"}] * 3},
        "body.contexts",
        "3 contexts",
    ),
    "a bad context": (
        {"contexts": [{"descriptor": "4a4a4a4a"}, {"descriptor": "4a4a4a4B"}]},
        "body.contexts.1.descriptor side 4",
        "weight B on shape 4",
    ),
    "two forms behind a known one": (
        {"contexts": [{"descriptor": "4a4a4a4a"}, {"descriptor": "4a4a4a4a", "indicator": INDICATOR}]},
        "body.contexts.1",
        "descriptor and indicator",
    ),
    "two kinds": (
        {"contexts": [{"descriptor": "4a4a4a4a"}, {"visual": base64.b64encode(LEVELS).decode()}]},
        "body.contexts",
        "kind indicator at 0 and kind visual at 1",
    ),
    "a short index": ({"context_index": [0]}, "body.context_index", "1 values"),
    "an index beyond": ({"context_index": [0, 1]}, "body.context_index.1", "an index"),
    "an index before": ({"context_index": [-1, 0]}, "body.context_index.0", "an index"),
    "an index without contexts": ({"contexts": None, "context_index": [0, 0]}, "body.contexts", "no contexts"),
    "three poses": ({"object_poses": [[0, 0, 0]] * 3}, "body.object_poses", "3 poses"),
    "a pose at the moon": ({"object_poses": [[4e8, 0, 0]]}, "body.object_poses.0", "4e+08 m"),
    "out of reach in the world": ({"object_poses": [[5.0, 0, 0]]}, "body.pushers.0", "-5 m"),
}


@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_in_a_batch_names_its_row(faked: TestClient, name: str) -> None:
    """Where it is, what came, what is accepted; one fault, however many rows have it."""
    body, where, received = FAULTS[name]
    in_order = {"pushers": [[0.0, 0.0, 0.0]] * 2, "contexts": [{"descriptor": "4a4a4a4a"}]}
    found = fault(faked.post("/v1/predict/batch", json=in_order | body))
    assert found[0] == where
    assert received in found[1]


VISUAL_FAULTS = {
    "not base64": ("%%%", "not base64"),
    "no padding": (base64.b64encode(LEVELS).decode().rstrip("="), "not base64"),
    "too few": (base64.b64encode(LEVELS[:-1]).decode(), "1023 bytes"),
    "31 rows": ([[0.0] * 32] * 31, "31 rows"),
    "a long row": ([[0.0] * 32] * 31 + [[0.0] * 33], "32 rows"),
    "brighter than white": ([[1.5] * 32] * 32, "outside"),
}


@pytest.mark.parametrize("name", VISUAL_FAULTS)
def test_a_visual_context_that_is_none_says_why(faked: TestClient, name: str) -> None:
    """Bytes that are not base64, too few, or numbers outside [0, 1]."""
    visual, received = VISUAL_FAULTS[name]
    body = {"pusher": {"x": 0.1, "y": 0.0, "angle": 0.0}, "context": {"visual": visual}}
    where, found = fault(faked.post("/v1/predict", json=body))
    assert where == "body.context.visual"
    assert received in found


def test_a_million_faults_cost_no_more_than_one(faked: TestClient) -> None:
    """The columns stop at the first, and so does the answer."""
    for column in (b'"pushers":', b'"pushers":[[0,0,0]],"contexts":', b'"pushers":[[0,0,0]],"context_index":'):
        content = b"{" + column + b"[" + b",".join([b"[null]"] * 1_000_000) + b"]}"
        response = faked.post("/v1/predict/batch", content=content, headers={"Content-Type": "application/json"})
        assert response.status_code == 422
        assert len(response.content) < 2000


def test_an_answer_is_what_the_documented_schema_says(shipped: TestClient) -> None:
    """The bytes are made by hand; the schema is the promise."""
    rows = {"pushers": [[-0.075, 0.0, 0.0]], "contexts": [{"descriptor": "1a2b3c4a"}]}
    for extra in ({}, {"object_poses": [[0.0, 0.0, 0.0]]}):
        BatchResponse.model_validate_json(json.dumps(batch(shipped, **rows, **extra)))
    one = single(shipped, [-0.075, 0.0, 0.0], "1a2b3c4a")
    PredictResponse.model_validate_json(json.dumps(one))
