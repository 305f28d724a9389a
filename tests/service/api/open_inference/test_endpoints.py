"""Endpoints of the Open Inference Protocol read compressed bodies, and weigh requests by their pushes."""

import gzip
import json
import zlib
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from fastapi.testclient import TestClient

from service.api.open_inference.endpoints import MODEL_PATH, VERSION_PATH, inference_endpoints, inflate
from service.errors import BodyTooLargeError, MalformedBodyError, UnsupportedMediaTypeError
from service.transport.endpoints import BODY_GROWTH, LIGHT_BYTES, Headers, HttpRequest
from tests.service.api.open_inference.tensors import INDICATOR, PUSHES, URL, document, error, numbers, packed, tensor


def test_a_path_names_a_model_an_alias_or_a_version(client: TestClient) -> None:
    """The answer names the version that predicted, which is the champion without an alias or a version."""
    versions = {
        URL: "1",
        "/v2/models/push-indicator/versions/2/infer": "2",
        "/v2/models/push-indicator@canary/infer": "2",
    }
    for path, version in versions.items():
        answer = client.post(path, json=document(id="42")).json()
        assert (answer["model_name"], answer["model_version"], answer["id"]) == ("push-indicator", version, "42")


def queued(client: TestClient) -> int:
    """Return the number of requests that a thread has answered."""
    lines = client.get("/metrics").text.splitlines()
    return sum(int(float(line.split()[-1])) for line in lines if line.startswith("cazsl_queue_wait_seconds_count"))


@pytest.mark.parametrize("encoding", [{}, {"Content-Encoding": "identity"}], ids=["plain", "plain by its header"])
@pytest.mark.parametrize(("pushes", "threads"), [(1, 0), (200, 0), (1000, 1)])
def test_many_pushes_are_predicted_in_a_thread(
    client: TestClient, pushes: int, threads: int, encoding: dict[str, str]
) -> None:
    """Many pushes, in JSON or raw, are predicted in a thread and get the numbers of few."""
    many = np.resize(PUSHES, (pushes, 3))
    content, header = packed(("pusher", many), ("context", INDICATOR[None]))
    nested = json.dumps(document(inputs=[tensor("pusher", many), tensor("context", INDICATOR[None])])).encode()
    expected = np.resize(numbers(client.post(URL, json=document()))["mean"], (pushes, 3)).tolist()
    for body, headers in ((content, header | encoding), (nested, encoding)):
        before = queued(client)
        assert numbers(client.post(URL, content=body, headers=headers))["mean"].tolist() == expected
        assert queued(client) - before == threads


@pytest.mark.parametrize("pack", [gzip.compress, zlib.compress], ids=["gzip", "deflate"])
def test_a_compressed_request_is_read(client: TestClient, pack: Any) -> None:
    """The length in the header is that of the JSON before compression."""
    content, headers = packed(("pusher", PUSHES), ("context", INDICATOR[None]))
    encoding = {"Content-Encoding": "gzip" if pack is gzip.compress else "deflate"}
    assert "mean" in numbers(client.post(URL, content=pack(content), headers=headers | encoding))


def test_a_broken_compressed_request_is_refused(client: TestClient) -> None:
    """A body that decompresses beyond the limit, half a stream, two streams and another encoding are refused."""
    bomb = gzip.compress(bytes(64 << 20))
    error(client.post(URL, content=bomb, headers={"Content-Encoding": "gzip"}), 413)
    whole = gzip.compress(json.dumps(document()).encode())
    for content in (whole[:-9], whole + whole, b"no gzip", b""):
        error(client.post(URL, content=content, headers={"Content-Encoding": "gzip"}))
    error(client.post(URL, content=whole, headers={"Content-Encoding": "br"}), 415)


@pytest.mark.parametrize(
    ("encoding", "pack"),
    [("gzip", gzip.compress), (" GZip ", gzip.compress), ("deflate", zlib.compress)],
    ids=["gzip", "capitals", "deflate"],
)
def test_a_stream_is_inflated(encoding: str, pack: Callable[[bytes], bytes]) -> None:
    """A body at the limit is decompressed, and one byte more is refused."""
    assert inflate(pack(b"x" * 100), encoding, 100) == b"x" * 100
    with pytest.raises(BodyTooLargeError):
        inflate(pack(b"x" * 101), encoding, 100)


@pytest.mark.parametrize(
    ("content", "encoding", "error_type"),
    [
        (b"x", "br", UnsupportedMediaTypeError),
        (b"x", "gzip", MalformedBodyError),
        (zlib.compress(b"x"), "gzip", MalformedBodyError),
        (gzip.compress(b"x")[:-1], "gzip", MalformedBodyError),
        (gzip.compress(b"x") + b"x", "gzip", MalformedBodyError),
        (b"", "deflate", MalformedBodyError),
    ],
    ids=["another encoding", "not a stream", "a stream of deflate", "half a stream", "trailing bytes", "no bytes"],
)
def test_a_broken_stream_is_refused(content: bytes, encoding: str, error_type: type[Exception]) -> None:
    """A body that is not one complete stream of its encoding is an error of the request."""
    with pytest.raises(error_type):
        inflate(content, encoding, 100)


@pytest.mark.parametrize(
    ("size", "headers", "is_quick"),
    [
        (LIGHT_BYTES, [], True),
        (LIGHT_BYTES + 1, [], False),
        (1, [(b"content-encoding", b"gzip")], False),
        (1, [(b"content-encoding", b"Identity")], True),
    ],
    ids=["small", "large", "compressed", "plain by its header"],
)
def test_the_event_loop_reads_small_plain_bodies_only(size: int, headers: Headers, is_quick: bool) -> None:
    """A thread reads large bodies, and decompresses."""
    for endpoint in inference_endpoints(1 << 20):
        assert endpoint.is_read_quickly(HttpRequest(headers, bytes(size), {"name": "push-none"})) is is_quick


def test_models_and_versions_have_an_endpoint_each() -> None:
    """The templates of the paths are those of the documented routes."""
    assert [endpoint.path for endpoint in inference_endpoints(1)] == [MODEL_PATH, VERSION_PATH]


@pytest.mark.parametrize(
    ("size", "encoding", "expected"),
    [(100, b"identity", 100), (100, b"gzip", 100 * 1032), (100_000, b"deflate", 4 << 20)],
    ids=["plain", "compressed", "compressed and large"],
)
def test_a_compressed_body_counts_as_the_most_that_it_becomes(size: int, encoding: bytes, expected: int) -> None:
    """The memory of a job is that of its decompressed body, which the limit of bodies bounds."""
    request = HttpRequest([(b"content-encoding", encoding)], bytes(size), {"name": "push-none"})
    assert inference_endpoints(4 << 20)[0].held_bytes(request) == BODY_GROWTH * expected
    zeros = zlib.compress(bytes(1 << 24), 9)
    assert 1032 * len(zeros) >= (1 << 24)
