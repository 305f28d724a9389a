"""Requests for single pushes over HTTP get predictions or problems, and no problem repeats a body."""

import json
import math
from typing import Any

import pytest
from fastapi.testclient import TestClient
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from service.inference.loaded_models import LoadedModels
from service.pushing.contexts import ObjectContext
from service.registry.registry import Registry
from tests.fakes import FAILING, STD, publish_fake
from tests.service.api.v1.requests import CONTEXT, JSON, PUSHER, predict, problem, send

INDICATOR = ObjectContext.from_descriptor("1a2b3c4a").indicator().tolist()
Served = tuple[Registry, LoadedModels]


def test_a_push_gets_a_gaussian_and_the_name_of_its_model(client: TestClient) -> None:
    """The answer has mean and std of the predictor, the frame, and the name and version of the model."""
    response = predict(client, {"pusher": PUSHER, "context": CONTEXT})
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
    """A descriptor and its indicator, of numbers or integers, are the same context."""
    by_name = predict(client, {"pusher": PUSHER, "context": CONTEXT})
    by_bits = predict(client, {"pusher": PUSHER, "context": {"indicator": INDICATOR}})
    by_integers = predict(client, {"pusher": PUSHER, "context": {"indicator": [int(bit) for bit in INDICATOR]}})
    assert by_name.json() == by_bits.json() == by_integers.json()


def test_without_a_context_the_model_that_needs_none_answers(client: TestClient) -> None:
    """Without a context, the default model is that for pushes without context."""
    assert predict(client, {"pusher": PUSHER}).json()["model"]["name"] == "push-none"
    assert predict(client, {"pusher": PUSHER, "context": None}).json()["model"]["name"] == "push-none"


@pytest.mark.parametrize("reference", ["push-indicator", "push-indicator@champion", "push-indicator@1"])
def test_a_request_may_name_its_model(client: TestClient, reference: str) -> None:
    """A request names its model by name, alias or version."""
    response = predict(client, {"pusher": PUSHER, "context": CONTEXT, "model": reference})
    assert response.json()["model"] == {"name": "push-indicator", "version": 1}


@pytest.mark.parametrize("turns", [1, -1, 5, 10**6])
def test_an_angle_is_circular(client: TestClient, turns: int) -> None:
    """Whole turns of the pusher change the answer by float rounding only."""
    turned = {**PUSHER, "angle": 0.3 + turns * 2 * math.pi}
    here = predict(client, {"pusher": {**PUSHER, "angle": 0.3}, "context": CONTEXT}).json()
    there = predict(client, {"pusher": turned, "context": CONTEXT}).json()
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
        {"pusher": PUSHER, "context": {**CONTEXT, "indicator": INDICATOR}},
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
def test_a_fault_names_field_received_and_accepted_values(client: TestClient, name: str) -> None:
    """A request with one fault gets a problem that names the field, the received and the accepted value."""
    body, where, received = FAULTS[name]
    found = problem(predict(client, body), 422, "invalid_request")["errors"]
    assert found[0]["where"] == where, found
    assert received in found[0]["received"]
    assert found[0]["accepted"]


@pytest.mark.parametrize("number", ["NaN", "Infinity", "-Infinity", "1e999", "-1e999"])
@pytest.mark.parametrize("field", ["x", "y", "angle"])
def test_a_number_that_is_not_finite_is_refused_by_field(client: TestClient, number: str, field: str) -> None:
    """NaN, infinities and overflowing numbers are refused with the name of their field."""
    body = json.dumps({"pusher": {**PUSHER, field: "HERE"}}).replace('"HERE"', number)
    found = problem(send(client, body), 422, "invalid_request")["errors"]
    assert found[0]["where"] == f"body.pusher.{field}"
    assert "not finite" in found[0]["received"]


def test_a_wrong_kind_of_context_is_refused(client: TestClient) -> None:
    """A model that takes a context refuses a push without one, and the other way round."""
    problem(predict(client, {"pusher": PUSHER, "model": "push-indicator"}), 422, "wrong_context_kind")
    problem(predict(client, {"pusher": PUSHER, "context": CONTEXT, "model": "push-none"}), 422, "wrong_context_kind")


def test_an_unknown_model_is_a_404(client: TestClient) -> None:
    """The problem of an unknown model lists the served versions."""
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
    ids=[
        "no value",
        "half a document",
        "not UTF-8",
        "two documents",
        "lone surrogate",
        "deep",
        "long number",
        "UTF-16",
    ],
)
def test_a_body_that_is_not_json_is_malformed(client: TestClient, content: bytes) -> None:
    """Bytes that are not one JSON document in UTF-8 are a 400."""
    found = problem(send(client, content), 400, "malformed_body")
    assert "accepted is JSON in UTF-8" in found["detail"]


def test_a_very_long_number_is_refused(client: TestClient) -> None:
    """A number with thousands of digits is neither converted nor repeated."""
    body = json.dumps({"pusher": {**PUSHER, "x": "HERE"}}).replace('"HERE"', "7" * 3000)
    response = send(client, body)
    assert response.status_code == 422
    assert "77777777777777777" not in response.text


def test_a_body_over_the_limit_is_refused(client: TestClient) -> None:
    """A body at the limit is read, and one more byte is refused, with a declared length or in chunks."""
    body = json.dumps({"pusher": PUSHER}).encode()
    assert send(client, body.ljust(4096)).status_code == 200
    problem(send(client, body.ljust(4097)), 413, "body_too_large")
    chunks = iter([body, b" " * 4096])
    response = client.post("/v1/predict", content=chunks, headers=JSON)
    assert "4096" in problem(response, 413, "body_too_large")["detail"]
    problem(client.request("GET", "/livez", content=b" " * 5000), 413, "body_too_large")


@pytest.mark.parametrize("secret", ["s3cret" * 3, "\u202e" * 5, "<script>" * 2])
def test_no_refusal_repeats_the_sent_values(client: TestClient, secret: str) -> None:
    """Values, long names of fields and unknown routes are described, and not repeated."""
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


def test_at_most_ten_faults_are_listed(client: TestClient) -> None:
    """The problem of a body with many faults stays small."""
    response = predict(client, {"pusher": PUSHER, "context": {"indicator": ["x"] * 36}})
    assert len(problem(response, 422, "invalid_request")["errors"]) == 10
    assert len(response.content) < 4096


def test_a_failing_runtime_is_a_500(client: TestClient, served: Served) -> None:
    """A failed prediction is a problem without its cause, and the service stays alive."""
    registry, models = served
    publish_fake(registry, model=FAILING)
    models.refresh()
    problem(predict(client, {"pusher": PUSHER, "context": CONTEXT}), 500, "prediction")
    assert client.get("/livez").status_code == 200


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
    """Any JSON document gets a prediction or a problem of the request."""
    response = send(client, json.dumps(body))
    assert response.status_code in (200, 422, 404), response.text


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None, max_examples=300)
@given(st.binary(max_size=200))
def test_no_bytes_get_a_5xx(client: TestClient, content: bytes) -> None:
    """Any bytes that are not JSON get a problem of the request."""
    assert send(client, content).status_code in (400, 422)
