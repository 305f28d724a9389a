"""The HTTP surface: answers, refusals, and that no body is ever repeated."""

import json
import math
from pathlib import Path
from typing import Any

import pytest
from fastapi.testclient import TestClient
from httpx2 import Response
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from service.app import create_app
from service.inference.loaded_models import LoadedModels
from service.pushing.contexts import ObjectContext
from service.registry.registry import Registry
from service.settings import Settings
from tests.fakes import FAILING, STD, load_fake, publish_fake

PUSHER = {"x": -0.075, "y": 0.0, "angle": 0.0}
OBJECT = {"descriptor": "1a2b3c4a"}
INDICATOR = ObjectContext.from_descriptor("1a2b3c4a").indicator().tolist()
JSON = {"Content-Type": "application/json"}
Served = tuple[Registry, LoadedModels]


def predict(client: TestClient, body: Any) -> Response:
    """POST a document."""
    return send(client, json.dumps(body))


def send(client: TestClient, content: bytes | str, headers: dict[str, str] = JSON) -> Response:
    """POST raw bytes."""
    return client.post("/v1/predict", content=content, headers=headers)


def problem(response: Response, status: int, code: str) -> dict[str, Any]:
    """The problem of a response that must be one."""
    assert response.headers["content-type"] == "application/problem+json"
    document: dict[str, Any] = response.json()
    assert (response.status_code, document["status"], document["code"]) == (status, status, code), document
    assert document["request_id"] == response.headers["x-request-id"]
    assert document["type"].endswith(code)
    assert set(document) == {"type", "title", "status", "code", "detail", "errors", "request_id"}
    return document


def test_a_push_gets_a_gaussian_and_the_model_that_made_it(client: TestClient) -> None:
    """The answer is the contract's, number for number."""
    response = predict(client, {"pusher": PUSHER, "context": OBJECT})
    assert response.status_code == 200
    answer = response.json()
    assert answer["model"] == {"name": "push-indicator", "version": 1}
    assert answer["frame"] == "object"
    assert answer["mean"] == {
        "x": pytest.approx(0.0075),
        "y": pytest.approx(0.0),
        "angle": pytest.approx(8 - 2 * math.pi, abs=1e-5),
    }
    assert answer["std"] == dict(zip(("x", "y", "angle"), map(pytest.approx, STD), strict=True))


def test_descriptor_and_indicator_get_the_same_answer(client: TestClient) -> None:
    """Two texts of one object."""
    by_name = predict(client, {"pusher": PUSHER, "context": OBJECT})
    by_bits = predict(client, {"pusher": PUSHER, "context": {"indicator": INDICATOR}})
    by_integers = predict(client, {"pusher": PUSHER, "context": {"indicator": [int(bit) for bit in INDICATOR]}})
    assert by_name.json() == by_bits.json() == by_integers.json()


def test_without_a_context_the_model_that_needs_none_answers(client: TestClient) -> None:
    """The default model follows what is known of the object."""
    assert predict(client, {"pusher": PUSHER}).json()["model"]["name"] == "push-none"
    assert predict(client, {"pusher": PUSHER, "context": None}).json()["model"]["name"] == "push-none"


@pytest.mark.parametrize("reference", ["push-indicator", "push-indicator@champion", "push-indicator@1"])
def test_a_model_can_be_asked_for_by_reference(client: TestClient, reference: str) -> None:
    """By name, alias or version."""
    response = predict(client, {"pusher": PUSHER, "context": OBJECT, "model": reference})
    assert response.json()["model"] == {"name": "push-indicator", "version": 1}


@pytest.mark.parametrize("turns", [1, -1, 5, 10**6])
def test_an_angle_is_circular(client: TestClient, turns: int) -> None:
    """Whole turns change nothing but float rounding."""
    turned = {**PUSHER, "angle": 0.3 + turns * 2 * math.pi}
    here = predict(client, {"pusher": {**PUSHER, "angle": 0.3}, "context": OBJECT}).json()
    there = predict(client, {"pusher": turned, "context": OBJECT}).json()
    for name in ("x", "y", "angle"):
        assert there["mean"][name] == pytest.approx(here["mean"][name], abs=1e-6)


FAULTS = {
    "missing pusher": ({}, "body.pusher", "no value"),
    "missing angle": ({"pusher": {"x": 0.0, "y": 0.0}}, "body.pusher.angle", "no value"),
    "x as text": ({"pusher": {**PUSHER, "x": "0.5"}}, "body.pusher.x", "a text of 3 characters"),
    "x as truth": ({"pusher": {**PUSHER, "x": True}}, "body.pusher.x", "true or false"),
    "x too far": ({"pusher": {**PUSHER, "x": 1.5}}, "body.pusher.x", "1.5"),
    "unknown field": ({"pusher": {**PUSHER, "yaw": 1}}, "body.pusher", "the field yaw"),
    "no context form": ({"pusher": PUSHER, "context": {}}, "body.context", "no form"),
    "both forms": (
        {"pusher": PUSHER, "context": {**OBJECT, "indicator": INDICATOR}},
        "body.context",
        "descriptor and indicator",
    ),
    "35 bits": ({"pusher": PUSHER, "context": {"indicator": INDICATOR[:35]}}, "body.context.indicator", "35 values"),
    "37 bits": ({"pusher": PUSHER, "context": {"indicator": [*INDICATOR, 0]}}, "body.context.indicator", "37 values"),
    "two shapes": (
        {"pusher": PUSHER, "context": {"indicator": [1, 1, *INDICATOR[2:]]}},
        "body.context.indicator side 1",
        "2 shapes (1, 2)",
    ),
    "short descriptor": (
        {"pusher": PUSHER, "context": {"descriptor": "1a"}},
        "body.context.descriptor",
        "2 characters",
    ),
    "shape 9": ({"pusher": PUSHER, "context": {"descriptor": "1a9b3c4a"}}, "body.context.descriptor side 2", "unknown"),
    "reference": ({"pusher": PUSHER, "model": "../etc"}, "body.model", "a text of 6 characters"),
    "a list": ([1, 2], "body", "a list of 2 values"),
    "null": (None, "body", ""),
}


@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_says_where_it_is_what_came_and_what_is_accepted(client: TestClient, name: str) -> None:
    """One fault, named by its field."""
    body, where, received = FAULTS[name]
    found = problem(predict(client, body), 422, "invalid_request")["errors"]
    assert found[0]["where"] == where, found
    assert received in found[0]["received"]
    assert found[0]["accepted"]


@pytest.mark.parametrize("number", ["NaN", "Infinity", "-Infinity", "1e999", "-1e999"])
@pytest.mark.parametrize("field", ["x", "y", "angle"])
def test_a_number_that_is_not_finite_is_refused_where_it_is(client: TestClient, number: str, field: str) -> None:
    """The framework's own answer to these is a 500."""
    body = json.dumps({"pusher": {**PUSHER, field: "HERE"}}).replace('"HERE"', number)
    found = problem(send(client, body), 422, "invalid_request")["errors"]
    assert found[0]["where"] == f"body.pusher.{field}"
    assert "not finite" in found[0]["received"]


def test_a_wrong_kind_of_context_names_the_kind_that_is_wanted(client: TestClient) -> None:
    """A model with context asked without one, and the other way round."""
    problem(predict(client, {"pusher": PUSHER, "model": "push-indicator"}), 422, "wrong_context_kind")
    problem(predict(client, {"pusher": PUSHER, "context": OBJECT, "model": "push-none"}), 422, "wrong_context_kind")


def test_an_unknown_model_is_a_404_that_lists_what_is_served(client: TestClient) -> None:
    """By version, alias or name."""
    found = problem(predict(client, {"pusher": PUSHER, "model": "push-none@7"}), 404, "unknown_model")
    assert "push-indicator@1" in found["detail"]


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"{",
        b"\xff\xfe",
        b"{} {}",
        b'{"pusher": {"x": "\\ud800"}}',
        b"[" * 2000,
        b'{"pusher": ' + b"1" * 4000 + b"x}",
        json.dumps({"pusher": PUSHER}).encode("utf-16"),
    ],
    ids=["no value", "half", "not UTF-8", "two documents", "lone surrogate", "deep", "long number", "UTF-16"],
)
def test_what_is_no_json_is_a_malformed_body(client: TestClient, content: bytes) -> None:
    """Whatever it is, it is a 400 with the place of the fault."""
    found = problem(send(client, content), 400, "malformed_body")
    assert "accepted is JSON in UTF-8" in found["detail"]


def test_a_5000_digit_number_is_refused(client: TestClient) -> None:
    """Large integers are neither converted nor repeated."""
    body = json.dumps({"pusher": {**PUSHER, "x": "HERE"}}).replace('"HERE"', "7" * 3000)
    response = send(client, body)
    assert response.status_code == 422
    assert "77777777777777777" not in response.text


@pytest.mark.parametrize("content_type", ["", "text/plain", "application/x-www-form-urlencoded", "application/jsonx"])
def test_a_body_must_be_declared_as_json(client: TestClient, content_type: str) -> None:
    """The default of curl is refused too; the error says which header to send."""
    headers = {"Content-Type": content_type}
    found = problem(send(client, json.dumps({"pusher": PUSHER}), headers), 415, "unsupported_media_type")
    assert "application/json" in found["detail"]


def test_json_by_another_name_is_json(client: TestClient) -> None:
    """Parameters, capitals and +json are fine."""
    for content_type in ("Application/JSON; charset=utf-8", "application/vnd.robot+json"):
        assert send(client, json.dumps({"pusher": PUSHER}), {"Content-Type": content_type}).status_code == 200


def test_a_body_over_the_limit_is_refused_declared_or_chunked(client: TestClient) -> None:
    """At the limit it is read, one byte more is refused, whatever the headers said."""
    body = json.dumps({"pusher": PUSHER}).encode()
    assert send(client, body.ljust(4096)).status_code == 200
    problem(send(client, body.ljust(4097)), 413, "body_too_large")
    chunks = iter([body, b" " * 4096])
    response = client.post("/v1/predict", content=chunks, headers=JSON)
    assert "4096" in problem(response, 413, "body_too_large")["detail"]
    problem(client.request("GET", "/livez", content=b" " * 5000), 413, "body_too_large")


@pytest.mark.parametrize("secret", ["s3cret" * 3, "\u202e" * 5, "<script>" * 2])
def test_no_refusal_repeats_what_was_sent(client: TestClient, secret: str) -> None:
    """Values, long field names and unknown routes are described, not echoed."""
    bodies: list[Any] = [
        {"pusher": secret},
        {"pusher": {**PUSHER, "x": secret}},
        {"pusher": PUSHER, "context": {"descriptor": secret}},
        {"pusher": PUSHER, "context": {"indicator": [secret] * 36}},
        {"pusher": PUSHER, "model": secret},
        {"pusher": PUSHER, f"{secret}{'n' * 40}": 1},
    ]
    for body in bodies:
        response = predict(client, body)
        assert response.status_code in (404, 422)
        assert secret not in response.text
        assert secret not in response.json()["detail"]


def test_at_most_ten_faults_are_told(client: TestClient) -> None:
    """The answer to a bad body stays small."""
    response = predict(client, {"pusher": PUSHER, "context": {"indicator": ["x"] * 36}})
    assert len(problem(response, 422, "invalid_request")["errors"]) == 10
    assert len(response.content) < 4096


def test_unknown_routes_and_methods_are_problems_too(client: TestClient) -> None:
    """404 and 405 have the one form, and 405 says what is allowed."""
    problem(client.get("/v1/nothing"), 404, "no_such_route")
    problem(client.get("/v1/models/", follow_redirects=False), 404, "no_such_route")
    response = client.get("/v1/predict")
    problem(response, 405, "method_not_allowed")
    assert response.headers["allow"] == "POST"


def test_a_failing_runtime_is_a_500_without_its_inside(client: TestClient, served: Served) -> None:
    """The service says that it failed, and goes on answering."""
    registry, models = served
    publish_fake(registry, model=FAILING)
    models.refresh()
    problem(predict(client, {"pusher": PUSHER, "context": OBJECT}), 500, "prediction")
    assert client.get("/livez").status_code == 200


def test_without_a_model_predictions_are_not_ready(tmp_path: Path) -> None:
    """503 with a moment to wait, on the prediction and on readiness."""
    models = LoadedModels(Registry(tmp_path / "nowhere"), load_fake)
    with TestClient(create_app(Settings(), models)) as client:
        response = predict(client, {"pusher": PUSHER, "context": OBJECT})
        problem(response, 503, "model_not_ready")
        assert response.headers["retry-after"] == "1"
        ready = client.get("/readyz")
        assert (ready.status_code, ready.json()["ready"]) == (503, False)
        assert "cannot be listed" in ready.json()["problems"][0]
        assert client.get("/livez").json() == {"live": True}


def test_readiness_names_a_broken_newcomer_and_stays_ready(client: TestClient, served: Served) -> None:
    """What is loaded keeps serving, and ops read why the new version does not."""
    registry, models = served
    publish_fake(registry, model=b"broken")
    models.refresh()
    ready = client.get("/readyz")
    assert ready.status_code == 200
    assert ready.json()["models"] == {"push-indicator": [1], "push-none": [1]}
    assert any("push-indicator@2 is broken" in text for text in ready.json()["problems"])
    assert predict(client, {"pusher": PUSHER, "context": OBJECT}).json()["model"]["version"] == 1


def test_models_are_listed_with_versions_and_aliases(client: TestClient) -> None:
    """The listing, one model, and one version with manifest and card."""
    listed = client.get("/v1/models").json()["models"]
    assert [model["name"] for model in listed] == ["push-indicator", "push-none"]
    assert client.get("/v1/models/push-indicator").json() == listed[0]
    assert listed[0] == {
        "name": "push-indicator",
        "method": "FCN + CM",
        "context_kind": "indicator",
        "versions": [1],
        "aliases": {"champion": 1},
    }
    version = client.get("/v1/models/push-indicator/versions/1").json()
    assert version["aliases"] == ["champion"]
    assert version["manifest"]["data"]["source"] == "fake pushes"
    assert version["card"] == "# push-indicator\n"


@pytest.mark.parametrize(
    ("path", "status"),
    [("/v1/models/none", 404), ("/v1/models/push-none/versions/9", 404), ("/v1/models/push-none/versions/x", 422)],
)
def test_a_model_that_is_not_served_cannot_be_shown(client: TestClient, path: str, status: int) -> None:
    """Unknown names and versions, and versions that are no numbers."""
    response = client.get(path)
    assert response.status_code == status
    assert response.headers["content-type"] == "application/problem+json"


def test_the_documentation_is_served(client: TestClient) -> None:
    """/docs for people, /openapi.json for programs."""
    assert client.get("/docs").status_code == 200
    assert client.get("/openapi.json").json()["info"]["title"] == "CAZSL"


documents = st.recursive(
    st.none() | st.booleans() | st.floats() | st.integers() | st.text(max_size=10),
    lambda inner: (
        st.lists(inner, max_size=4)
        | st.dictionaries(st.sampled_from(["pusher", "context", "model", "x", "y", "angle", "descriptor", "?"]), inner)
    ),
    max_leaves=12,
)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None, max_examples=300)
@given(st.one_of(documents, documents.map(lambda inner: {"pusher": PUSHER, "context": inner})))
def test_no_document_gets_a_5xx(client: TestClient, body: Any) -> None:
    """Whatever JSON comes, the answer is a prediction or a problem of the caller's."""
    response = send(client, json.dumps(body))
    assert response.status_code in (200, 422, 404), response.text


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None, max_examples=300)
@given(st.binary(max_size=200))
def test_no_bytes_get_a_5xx(client: TestClient, content: bytes) -> None:
    """Nor do bytes that are no JSON."""
    assert send(client, content).status_code in (400, 422)
