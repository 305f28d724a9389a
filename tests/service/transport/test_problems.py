"""Answers to failures have one form under /v1 and that of the Open Inference Protocol under /v2."""

import json
from typing import Any

import pytest
from starlette.responses import Response

from service.errors import (
    CazslError,
    FieldFault,
    InvalidRequestError,
    MissingKeyError,
    OverloadedError,
    SlowBodyError,
    TooManyRequestsError,
)
from service.observability.records import RequestRecord, attach_record, record_of
from service.transport.problems import internal_error, problem_body, problem_response, render_problem

FAULT = FieldFault("body.pusher.x", "1.5", "-1 to 1 m")


def scope(path: str = "/v1/predict") -> dict[str, Any]:
    """Return the scope of a request with a record."""
    found: dict[str, Any] = {"path": path}
    attach_record(found, RequestRecord("one", "POST"))
    return found


def document(response: Response) -> Any:
    """Return the document of a response."""
    return json.loads(bytes(response.body))


def test_a_problem_names_each_fault_and_the_request() -> None:
    """Under /v1 a problem has the code, the title, the faults and the request id."""
    response = problem_response(scope(), InvalidRequestError([FAULT]))
    assert (response.status_code, response.media_type) == (422, "application/problem+json")
    assert document(response) == {
        "type": "urn:cazsl:problem:invalid_request",
        "title": InvalidRequestError.title,
        "status": 422,
        "code": "invalid_request",
        "detail": str(FAULT),
        "errors": [{"where": "body.pusher.x", "received": "1.5", "accepted": "-1 to 1 m"}],
        "request_id": "one",
    }


def test_an_error_under_v2_is_a_text() -> None:
    """The protocol has one field for errors, and 400 for an invalid request."""
    response = problem_response(scope("/v2/models/push-none/infer"), InvalidRequestError([FAULT]))
    assert (response.status_code, response.media_type) == (400, "application/json")
    assert document(response) == {"error": str(FAULT)}


def test_the_code_of_a_problem_is_noted_in_the_record() -> None:
    """The log line and the metrics of a refused request have its code."""
    found = scope()
    problem_response(found, MissingKeyError())
    assert record_of(found).code == "missing_key"


def test_a_problem_has_ten_faults_at_most() -> None:
    """The answer to a body with many faults stays small."""
    assert len(document(problem_response(scope(), InvalidRequestError([FAULT] * 30)))["errors"]) == 10


@pytest.mark.parametrize(
    ("error", "name", "value"),
    [
        (MissingKeyError(), "WWW-Authenticate", "Bearer"),
        (SlowBodyError(10.0), "Connection", "close"),
        (TooManyRequestsError(8), "Retry-After", "1"),
        (OverloadedError("256 requests in flight"), "Retry-After", "1"),
    ],
    ids=lambda value: type(value).__name__ if isinstance(value, CazslError) else str(value),
)
def test_a_problem_has_the_headers_of_its_status(error: CazslError, name: str, value: str) -> None:
    """401 names the scheme of keys, 408 closes the connection, 429 and 503 give a pause."""
    assert problem_response(scope(), error).headers[name] == value


def test_an_internal_error_points_to_the_log() -> None:
    """A client learns no cause of an unexpected exception, only where the operator finds it."""
    response = problem_response(scope(), internal_error())
    assert (response.status_code, document(response)["code"]) == (500, "internal")
    assert "request_id" in document(response)["detail"]


def test_a_failure_of_the_framework_keeps_its_headers() -> None:
    """A problem without an error of our tree has the given status, code and headers."""
    response = render_problem(
        scope(), 405, "method_not_allowed", "Method not allowed", "see /docs", headers={"Allow": "POST"}
    )
    assert (response.status_code, response.headers["Allow"]) == (405, "POST")


def test_a_problem_without_a_request_has_no_request_id() -> None:
    """A connection that refuses bytes before there is a request sends the same document."""
    body = json.loads(problem_body(SlowBodyError.status, "slow_head", "Request Timeout", "head: late"))
    assert (body["code"], body["errors"], body["request_id"]) == ("slow_head", [], "")


@pytest.mark.parametrize("path", ["/v1/predict", "/v2/models/a/infer"])
def test_an_answer_has_a_few_kib_whatever_is_in_its_message(path: str) -> None:
    """Long texts and more than ten faults are cut, so no refusal has more than a few KiB."""
    long = FieldFault("w" * 100_000, "r" * 100_000, "a" * 100_000)
    for error in (InvalidRequestError([long] * 100), OverloadedError("n" * 100_000)):
        response = problem_response(scope(path), error)
        assert len(response.body) < 8192
        assert len(json.loads(bytes(response.body)).get("errors", ())) <= 10
