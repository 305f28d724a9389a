"""Refinement over HTTP: the context of an object comes back with what its pushes tell."""

import base64
import io
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fastapi.testclient import TestClient
from PIL import Image, ImageDraw

from service.app import create_app
from service.inference.loaded_models import LoadedModels
from service.model.predictor import OnnxPredictor
from service.registry.registry import Registry
from service.schemas.shapes import OUTLINE_EXAMPLE
from service.settings import Settings

PATH = "/v1/contexts/refine"
BOX = {"outline": OUTLINE_EXAMPLE}
LOADED = BOX | {"centre_of_mass": [0.035, 0.0], "friction": 0.2}
PUSHERS = [
    [-0.08, 0.02, 0.0],
    [-0.08, -0.02, 0.0],
    [0.08, 0.02, 3.14159],
    [0.02, -0.06, 1.5708],
    [-0.03, -0.06, 1.5708],
    [0.04, 0.06, -1.5708],
    [-0.01, 0.06, -1.5708],
    [0.08, -0.01, 3.14159],
]


@pytest.fixture(scope="module")
def client(project_root: Path) -> Iterator[TestClient]:
    """Return a client of the application over the models that ship."""
    models = LoadedModels(Registry(project_root / "models"), OnnxPredictor)
    with TestClient(create_app(Settings(poll_interval_s=3600), models), raise_server_exceptions=False) as found:
        yield found


def answered(client: TestClient, path: str, body: dict[str, Any]) -> Any:
    """Send a valid request, and return the document of its answer."""
    response = client.post(path, json=body)
    assert response.status_code == 200, response.text
    return response.json()


def predicted(client: TestClient, context: dict[str, Any]) -> list[list[float]]:
    """Return the outcomes of the pushes of an object, as the model predicts them."""
    found = answered(client, "/v1/predict/batch", {"pushers": PUSHERS, "lengths": 0.04, "contexts": [context]})
    mean: list[list[float]] = found["mean"]
    return mean


def refined(client: TestClient, **fields: Any) -> Any:
    """Return the answer to the pushes of a loaded box."""
    body = {"context": BOX, "pushers": PUSHERS, "lengths": 0.04, "outcomes": predicted(client, LOADED)}
    return answered(client, PATH, body | fields)


def test_pushes_tell_where_the_weight_is(client: TestClient) -> None:
    """With the refined context, predictions of a loaded box are at least three times as near as before."""
    found = refined(client)
    assert found["model"]["name"] == "push-shape"
    assert (found["frame"], found["outliers"], found["warnings"]) == ("object", [], [])
    assert found["context"]["outline"] == OUTLINE_EXAMPLE
    truth = np.array(predicted(client, LOADED))
    before, after = (np.abs(truth - predicted(client, context)).mean() for context in (BOX, found["context"]))
    assert after < before / 3.0
    assert set(found["context"]["posterior"]) == {"std", "correlation"}


def test_a_refined_context_can_be_refined_again(client: TestClient) -> None:
    """The answer comes back with the same pushes, and its values become surer."""
    once = refined(client)["context"]
    twice = refined(client, context=once)["context"]
    assert sum(twice["posterior"]["std"][:2]) < sum(once["posterior"]["std"][:2])


def test_pushes_in_the_world_tell_the_same(client: TestClient) -> None:
    """An object that stands elsewhere and is turned has the same body."""
    plain = refined(client)["context"]["centre_of_mass"]
    turn = np.pi / 2
    poses = [[0.4, 0.1, turn]]
    placed = [[0.4 - y, 0.1 + x, angle + turn] for x, y, angle in PUSHERS]
    outcomes = [[0.4 - y, 0.1 + x, angle + turn] for x, y, angle in predicted(client, LOADED)]
    found = refined(client, object_poses=poses, pushers=placed, outcomes=outcomes)
    assert found["context"]["centre_of_mass"] == pytest.approx(plain, abs=1e-4)


def test_a_slipped_gripper_is_named(client: TestClient) -> None:
    """An object that did not move in one of eight pushes is an outlier, and the others tell the rest."""
    outcomes = predicted(client, LOADED)
    outcomes[2] = [0.03, 0.0, 1.5]
    found = refined(client, outcomes=outcomes)
    assert found["outliers"] == [2]
    assert found["context"]["centre_of_mass"][0] > 0.02


def test_one_push_that_misses_tells_little(client: TestClient) -> None:
    """A push beside the object says nothing, and the answer says so."""
    found = refined(client, pushers=[[-0.1, 0.2, 0.0]], outcomes=[[0.0, 0.0, 0.0]])
    codes = {warning["code"] for warning in found["warnings"]}
    assert {"no_contact", "little_learnt"} <= codes
    assert found["context"]["centre_of_mass"] == pytest.approx([0.0, 0.0], abs=0.006)


def test_wrong_frames_are_named(client: TestClient) -> None:
    """Outcomes that belong to other pushes are mostly outliers, and a warning says what to compare."""
    found = refined(client, outcomes=[[0.4, 0.3, 1.0]] * len(PUSHERS))
    assert "many_outliers" in {warning["code"] for warning in found["warnings"]}


def test_an_object_in_an_image_with_its_scale_is_refined_too(client: TestClient) -> None:
    """The answer has the outline that was found, so that the image is sent once."""
    image = Image.new("L", (400, 300))
    ImageDraw.Draw(image).rectangle((80, 70, 319, 229), fill=255)
    buffer = io.BytesIO()
    image.save(buffer, "PNG")
    context = {"image": base64.b64encode(buffer.getvalue()).decode(), "metres_per_pixel": 0.0005}
    found = refined(client, context=context)["context"]
    assert np.array(found["outline"]).max(axis=0) == pytest.approx([0.06, 0.04], abs=0.001)
    assert "image" not in found


@pytest.mark.parametrize(
    ("fields", "code", "where"),
    [
        ({"context": {"descriptor": "1a2b3c4a"}}, "invalid_request", "body.context"),
        ({"context": BOX | {"posterior": {"std": [1.0] * 6, "correlation": np.eye(6).tolist()}}}, "", "posterior"),
        ({"model": "push-none", "lengths": 0.05}, "wrong_context_kind", "body.context"),
        ({"model": "push-nothing"}, "unknown_model", ""),
        ({"pushers": [[0.0, 0.0, 0.0]] * 8}, "invalid_request", "body.pushers.0"),
        ({"pushers": PUSHERS * 7}, "invalid_request", "body.pushers"),
        ({"lengths": [0.04, 0.04]}, "invalid_request", "body.lengths"),
    ],
)
def test_requests_that_cannot_be_answered_are_refused(
    client: TestClient, fields: dict[str, Any], code: str, where: str
) -> None:
    """A refusal names the field and the reason."""
    body = {"context": BOX, "pushers": PUSHERS, "lengths": 0.04, "outcomes": [[0.0, 0.0, 0.0]] * 8} | fields
    response = client.post(PATH, json=body)
    assert 400 <= response.status_code < 500
    assert code in response.json()["code"]
    assert where in response.text
