"""Endpoints of ``/v1`` check headers, and weigh requests by their contexts and their bytes."""

import json
from collections.abc import Callable

import pytest
from fastapi.testclient import TestClient

from service.api.v1.endpoints import (
    BATCH,
    CONTEXTS,
    IMAGE,
    LIGHT_BATCH_BYTES,
    LIGHT_CONTEXTS,
    SINGLE,
    check_accept,
    check_json,
    check_plain,
)
from service.errors import NotAcceptableError, RequestError, UnsupportedMediaTypeError
from service.schemas.contexts import IMAGE_EXAMPLE, ContextBody
from service.schemas.pushes import BatchRequest, PredictRequest
from service.transport.endpoints import LIGHT_BYTES, NO_PARAMETERS, Headers, HttpRequest, Weight
from tests.service.api.v1.requests import CONTEXT, PUSHER, problem, send


@pytest.mark.parametrize("content_type", ["", "text/plain", "application/x-www-form-urlencoded", "application/jsonx"])
def test_a_body_must_be_declared_as_json(client: TestClient, content_type: str) -> None:
    """A body without a JSON content type is refused, and the problem names the header to send."""
    headers = {"Content-Type": content_type}
    found = problem(send(client, json.dumps({"pusher": PUSHER}), headers), 415, "unsupported_media_type")
    assert "application/json" in found["detail"]


def test_json_content_types_are_accepted(client: TestClient) -> None:
    """A JSON content type may have parameters, capitals or the suffix +json."""
    for content_type in ("Application/JSON; charset=utf-8", "application/vnd.robot+json"):
        assert send(client, json.dumps({"pusher": PUSHER}), {"Content-Type": content_type}).status_code == 200


@pytest.mark.parametrize(
    ("accept", "accepted"),
    [
        (b"*/*", True),
        (b"application/*", True),
        (b"text/html, Application/JSON;q=0.5", True),
        (b"application/json;q=0;x=1, */*;q=0.5", True),
        (b"application/json ; charset=utf-8 ; q=0.001", True),
        (b"a/b," * 3000 + b"*/*", True),
        (b"," * 15_000, False),
        (b";" * 15_000, False),
        (b"application/jsonx, x-application/json, text/x;a=application/json", False),
        (b"application/json ; charset=utf-8 ; Q = 0", False),
        (b"text/html", False),
        (b"application/json; q=0", False),
        (b"application/json;q=0.000, text/html", False),
        (b"", False),
    ],
)
def test_the_accept_header_must_include_json(accept: bytes, accepted: bool) -> None:
    """A media range with weight 0 excludes JSON, and a request without the header accepts it."""
    check_accept([])
    if accepted:
        check_accept([(b"accept", accept)])
    else:
        with pytest.raises(NotAcceptableError):
            check_accept([(b"accept", accept)])


@pytest.mark.parametrize(
    ("check", "headers", "error"),
    [
        (check_json, [(b"accept", b"x/y"), (b"content-encoding", b"gzip")], NotAcceptableError),
        (
            check_json,
            [(b"content-encoding", b"gzip"), (b"content-type", b"application/json")],
            UnsupportedMediaTypeError,
        ),
        (check_json, [(b"content-type", b"text/plain")], UnsupportedMediaTypeError),
        (check_plain, [(b"content-encoding", b"identity")], UnsupportedMediaTypeError),
    ],
    ids=["accept first", "compressed", "another type", "any encoding"],
)
def test_headers_are_checked_in_order(
    check: Callable[[Headers], None], headers: Headers, error: type[RequestError]
) -> None:
    """The accepted types are checked first, then the encoding, then the content type."""
    with pytest.raises(error):
        check(headers)


IMAGE_CONTEXT = ContextBody(image=IMAGE_EXAMPLE)
ONE_PUSH = PredictRequest.model_validate({"pusher": PUSHER, "context": CONTEXT})


@pytest.mark.parametrize(
    ("contexts", "weight"),
    [
        (None, Weight.LIGHT),
        ([ContextBody(descriptor="1a2b3c4a")] * LIGHT_CONTEXTS, Weight.LIGHT),
        ([ContextBody(descriptor="1a2b3c4a")] * (LIGHT_CONTEXTS + 1), Weight.HEAVY),
        ([IMAGE_CONTEXT], Weight.HEAVY),
    ],
    ids=["no contexts", "few contexts", "many contexts", "an image"],
)
def test_a_batch_is_weighed_by_its_contexts(contexts: list[ContextBody] | None, weight: Weight) -> None:
    """Images and many contexts are encoded in a thread."""
    pushers = [[0.0, 0.0, 0.0]] * max(1, len(contexts or ()))
    assert BATCH.weigh(BatchRequest.model_validate({"pushers": pushers, "contexts": contexts})) is weight


def test_a_push_is_single_unless_it_has_an_image() -> None:
    """A push with an image, as base64 or as a file, is decoded in a thread."""
    assert SINGLE.weigh(ONE_PUSH) is Weight.SINGLE
    assert SINGLE.weigh(ONE_PUSH.model_copy(update={"context": IMAGE_CONTEXT})) is Weight.HEAVY


def test_the_event_loop_reads_small_bodies_only() -> None:
    """Each endpoint has its limit of bytes, and uploads are always read in a thread."""

    def request(size: int) -> HttpRequest:
        """Return a request with a body of this size."""
        return HttpRequest([], bytes(size), NO_PARAMETERS)

    for endpoint, limit in ((SINGLE, LIGHT_BYTES), (BATCH, LIGHT_BATCH_BYTES)):
        assert endpoint.is_read_quickly(request(limit))
        assert not endpoint.is_read_quickly(request(limit + 1))
    assert not IMAGE.is_read_quickly(request(1))
    assert not CONTEXTS.is_read_quickly(request(1))
