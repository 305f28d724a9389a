"""Queries of tensors follow the rules of ``/v1``, and give the requested outputs."""

import json
from typing import Any

import numpy as np
import pytest
from fastapi.testclient import TestClient

from service.api.open_inference.queries import parse_reference
from service.errors import InvalidRequestError
from service.model.reference import ModelReference
from service.pushing.contexts import SupportContext
from service.pushing.shape_context import ShapeContext
from tests.served_graphs import BOX, shape_tensors
from tests.service.api.open_inference.tensors import (
    INDICATOR,
    LENGTH,
    PUSHES,
    URL,
    changed,
    document,
    error,
    numbers,
    tensor,
)


def test_the_flag_of_an_output_overrides_that_of_the_request(client: TestClient) -> None:
    """Outputs come in the requested order, only those requested, and each may have its own form."""
    wanted = [{"name": "std"}, {"name": "mean", "parameters": {"binary_data": False}}]
    response = client.post(URL, json=document(parameters={"binary_data_output": True}, outputs=wanted))
    head = json.loads(response.content[: int(response.headers[LENGTH])])
    assert [output["name"] for output in head["outputs"]] == ["std", "mean"]
    assert ["data" in output for output in head["outputs"]] == [False, True]
    assert response.headers["content-type"] == "application/octet-stream"
    assert list(numbers(client.post(URL, json=document(outputs=[{"name": "mean"}])))) == ["mean"]


def test_a_visual_model_takes_levels_rounded_to_eight_bits(client: TestClient) -> None:
    """Levels of a visual context are rounded to those of /v1, and levels outside [0, 1] are refused."""
    grey = np.full((1, 1, 32, 32), 0.5, dtype=np.float32)
    inputs = [tensor("pusher", PUSHES), tensor("context", grey)]
    found = numbers(client.post("/v2/models/push-visual/infer", json={"inputs": inputs}))
    body = {"pushers": PUSHES.tolist(), "contexts": [{"visual": [[0.5] * 32] * 32}]}
    expected = client.post("/v1/predict/batch", json=body).json()["mean"]
    assert (found["mean"] == np.array(expected, dtype=np.float32)).all()
    too_bright = [tensor("pusher", PUSHES), tensor("context", grey * 3)]
    assert "[0, 1]" in error(client.post("/v2/models/push-visual/infer", json={"inputs": too_bright}))


TWO_SHAPES = INDICATOR.copy()
TWO_SHAPES[1] = 1.0
INDEX = tensor("context_index", np.array([0, 1], dtype=np.int64))
BAD: dict[str, tuple[Any, str]] = {
    "no pusher": (document(inputs=[tensor("context", INDICATOR[None])]), "no tensor pusher"),
    "no context": (document(inputs=[tensor("pusher", PUSHES)]), "no tensor context"),
    "out of reach": (changed(0, data=[0, 0, 0, 0, 1.5, 0]), "pusher[1]"),
    "two shapes": (changed(1, data=TWO_SHAPES[None].tolist()), "inputs context[0] side 1"),
    "no such place": ({"inputs": [*document()["inputs"], INDEX]}, "context_index"),
    "a short index": (
        {"inputs": [*document()["inputs"], INDEX | {"shape": [1], "data": [0]}]},
        "2 values: one per push",
    ),
    "three contexts": (changed(1, shape=[3, 36], data=[INDICATOR.tolist()] * 3), "3 contexts"),
    "unknown output": (document(outputs=[{"name": "covariance"}]), "outputs"),
}


@pytest.mark.parametrize("name", BAD)
def test_a_request_against_the_rules_is_a_400_that_names_its_field(client: TestClient, name: str) -> None:
    """A push, a context or an output that /v1 would refuse is refused with its field."""
    body, words = BAD[name]
    text = error(client.post(URL, content=json.dumps(body)))
    assert words in text
    assert client.get("/v2/health/live").status_code == 200


SHAPES = dict(zip(("silhouette", "outline", "support", "body"), shape_tensors(ShapeContext(BOX)), strict=True))
LONG_PUSHES = np.array([[-0.1, 0.0, 0.0, 0.05], [0.0, -0.1, 1.5, 0.02]], dtype=np.float32)


def of_shapes(pushes: np.ndarray[Any, Any], **changes: np.ndarray[Any, Any]) -> dict[str, Any]:
    """Return a request for pushes of a box, with other tensors in place of some of its own."""
    tensors = {"pusher": pushes, **SHAPES, **changes}
    return {"inputs": [tensor(name, array) for name, array in tensors.items()]}


def test_shapes_are_answered_as_in_v1(client: TestClient) -> None:
    """The tensors of an outline and lengths give the numbers that /v1 gives for the outline."""
    found = numbers(client.post("/v2/models/push-shape/infer", json=of_shapes(LONG_PUSHES)))
    body = {
        "pushers": LONG_PUSHES[:, :3].tolist(),
        "lengths": LONG_PUSHES[:, 3].tolist(),
        "contexts": [{"outline": BOX.corners.tolist()}],
    }
    expected = client.post("/v1/predict/batch", json=body).json()["mean"]
    assert (found["mean"] == np.array(expected, dtype=np.float32)).all()


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"pusher": LONG_PUSHES * np.array([1, 1, 1, 0], dtype=np.float32)}, "inputs pusher[0, 3]: received 0 m"),
        ({"pusher": LONG_PUSHES * np.array([1, 1, 1, 30], dtype=np.float32)}, "inputs pusher[0, 3]: received 1.5 m"),
        ({"pusher": LONG_PUSHES * np.array([200, 1, 1, 1], dtype=np.float32)}, "inputs pusher[0]"),
        (
            {"pusher": LONG_PUSHES * np.array([1, 0, 1, 1], dtype=np.float32)},
            "inputs pusher[1]: received a pusher that starts inside",
        ),
        ({"pusher": LONG_PUSHES[:, :3]}, "inputs pusher.shape"),
        ({"body": SHAPES["body"] * np.float32(0.0)}, "inputs body[0, 2]"),
        ({"silhouette": SHAPES["silhouette"] + np.float32(3.0)}, "inputs silhouette"),
        ({"outline": SHAPES["outline"] + np.float32(30.0)}, "inputs outline"),
    ],
)
def test_a_shape_against_the_rules_is_a_400(
    client: TestClient, changes: dict[str, np.ndarray[Any, Any]], words: str
) -> None:
    """A push or an object that /v1 refuses is refused with its tensor."""
    pushes = changes.pop("pusher", LONG_PUSHES)
    assert words in error(client.post("/v2/models/push-shape/infer", json=of_shapes(pushes, **changes)))


SUPPORT = SupportContext.of(np.array([[-0.08, 0.0, 0.0]] * 3), np.array([[0.02, 0.0, 0.1]] * 3))
SUPPORTS = {
    name: tensor[None]
    for name, tensor in zip(("support_pushers", "support_outcomes", "support_valid"), SUPPORT.tensors(), strict=True)
}


def of_supports(**changes: np.ndarray[Any, Any]) -> dict[str, Any]:
    """Return a request for pushes of an object with a support, with other tensors in place of some of its own."""
    tensors = {"pusher": LONG_PUSHES[:, :3], **SUPPORTS, **changes}
    return {"inputs": [tensor(name, array) for name, array in tensors.items()]}


def test_supports_are_answered_as_in_v1(client: TestClient) -> None:
    """The tensors of a support give the numbers that /v1 gives for it."""
    found = numbers(client.post("/v2/models/push-anp/infer", json=of_supports()))
    context = {"support": {"pushers": SUPPORT.pushers.tolist(), "outcomes": SUPPORT.outcomes.tolist()}}
    body = {"pushers": LONG_PUSHES[:, :3].tolist(), "contexts": [context]}
    expected = client.post("/v1/predict/batch", json=body).json()["mean"]
    assert (found["mean"] == np.array(expected, dtype=np.float32)).all()


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"support_valid": SUPPORTS["support_valid"] * np.float32(0.0)}, "inputs support_valid"),
        ({"support_valid": SUPPORTS["support_valid"] * np.float32(0.5)}, "inputs support_valid"),
        ({"support_valid": SUPPORTS["support_valid"][:, :49]}, "inputs support_valid.shape"),
        ({"support_pushers": SUPPORTS["support_pushers"] * np.float32(90.0)}, "inputs support_pushers[0, 0, 0]"),
        ({"support_outcomes": np.repeat(SUPPORTS["support_outcomes"], 2, axis=0)}, "2 contexts"),
    ],
)
def test_a_support_against_the_rules_is_a_400(
    client: TestClient, changes: dict[str, np.ndarray[Any, Any]], words: str
) -> None:
    """A support that /v1 refuses is refused with its tensor."""
    assert words in error(client.post("/v2/models/push-anp/infer", json=of_supports(**changes)))


@pytest.mark.parametrize(
    ("model", "version", "reference"),
    [
        ("push-none", None, ModelReference("push-none", "champion", None)),
        ("push-none@canary", None, ModelReference("push-none", "canary", None)),
        ("push-none", "7", ModelReference("push-none", None, 7)),
        ("push-none@canary", "7", ModelReference("push-none", None, 7)),
    ],
)
def test_a_path_names_a_model(model: str, version: str | None, reference: ModelReference) -> None:
    """A version in the path overrides the alias of its model."""
    assert parse_reference(model, version) == reference


@pytest.mark.parametrize(("model", "version"), [("Push", None), ("a b", None), ("push-none", "0"), ("push-none", "x")])
def test_a_path_that_names_no_model_is_refused(model: str, version: str | None) -> None:
    """A name or a version that is not valid is an error of the request."""
    with pytest.raises(InvalidRequestError):
        parse_reference(model, version)


def test_warnings_are_a_text_among_the_parameters(client: TestClient) -> None:
    """The parameter has the warnings of /v1 as JSON, whatever the form of the outputs, and an empty list if none."""
    rows = np.array([[-0.08, 0.0, 0.0], [-0.5, 0.0, 0.0]], dtype=np.float32)
    view = np.zeros((1, 1, 32, 32), dtype=np.float32)
    inputs = [tensor("pusher", rows), tensor("context", view)]
    found = client.post("/v2/models/push-visual/infer", json={"inputs": inputs}).json()
    body = {"pushers": rows.tolist(), "contexts": [{"visual": [[0.0] * 32] * 32}]}
    expected = client.post("/v1/predict/batch", json=body).json()["warnings"]
    assert json.loads(found["parameters"]["warnings"]) == expected
    assert {"image_blank"} <= {warning["code"] for warning in expected}
