"""The Open Inference Protocol: JSON and raw tensors, refusals with places, and that it predicts what /v1 predicts."""

import gzip
import json
import zlib
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
from service.model.tensors import ContextKind
from service.pushing.contexts import ObjectContext
from service.registry.registry import Registry
from service.settings import Settings
from tests.fakes import fake_models, load_fake, publish_fake

INDICATOR = ObjectContext.from_descriptor("1a2b3c4a").indicator()
PUSHES = np.array([[0.1, 0.0, 0.0], [0.2, 0.05, 4.0]], dtype=np.float32)
URL = "/v2/models/push-indicator/infer"
LENGTH = "Inference-Header-Content-Length"


@pytest.fixture(scope="module")
def client(tmp_path_factory: pytest.TempPathFactory) -> Iterator[TestClient]:
    """The app over fakes of every kind."""
    registry, models = fake_models(tmp_path_factory.mktemp("models"))
    publish_fake(registry, "push-visual", ContextKind.VISUAL)
    publish_fake(registry, alias="canary")
    models.refresh()
    app = create_app(Settings(poll_interval_s=3600, max_body_bytes=1 << 20), models)
    with TestClient(app, raise_server_exceptions=False) as found:
        yield found


def tensor(name: str, array: np.ndarray[Any, Any], **changes: Any) -> dict[str, Any]:
    """A tensor in JSON, nested."""
    datatype = "INT64" if array.dtype == np.int64 else "FP32"
    return {"name": name, "shape": list(array.shape), "datatype": datatype, "data": array.tolist()} | changes


def document(**changes: Any) -> dict[str, Any]:
    """A request that is in order."""
    return {"inputs": [tensor("pusher", PUSHES), tensor("context", INDICATOR[None])]} | changes


def packed(*arrays: tuple[str, np.ndarray[Any, Any]], **changes: Any) -> tuple[bytes, dict[str, str]]:
    """A request in the binary form, and its header."""
    inputs = [tensor(name, array, parameters={"binary_data_size": array.nbytes}) for name, array in arrays]
    for part in inputs:
        del part["data"]
    head = json.dumps({"inputs": inputs} | changes).encode()
    return head + b"".join(array.tobytes() for _, array in arrays), {LENGTH: str(len(head))}


def error(response: Response, status: int = 400) -> str:
    """The text of an error, in the protocol's one form."""
    assert response.status_code == status, response.text
    assert response.headers["content-type"] == "application/json"
    assert set(response.json()) == {"error"}
    text = response.json()["error"]
    assert isinstance(text, str)
    return text


def numbers(response: Response) -> dict[str, np.ndarray[Any, Any]]:
    """The outputs of an answer, JSON or raw, by name."""
    assert response.status_code == 200, response.text
    length = int(response.headers.get(LENGTH, len(response.content)))
    head, raw, found = json.loads(response.content[:length]), response.content[length:], {}
    for output in head["outputs"]:
        assert output["datatype"] == "FP32"
        if "data" in output:
            array = np.array(output["data"], dtype=np.float32)
        else:
            size = output["parameters"]["binary_data_size"]
            array, raw = np.frombuffer(raw[:size], dtype="<f4"), raw[size:]
        found[output["name"]] = array.reshape(output["shape"])
    assert not raw
    return found


def test_health_and_metadata_are_the_protocols(client: TestClient) -> None:
    """What a client asks first."""
    assert client.get("/v2/health/live").json() == {"live": True}
    assert client.get("/v2/health/ready").json() == {"live": True, "ready": True}
    assert client.get("/v2").json()["name"] == "cazsl"
    assert client.get("/v2").json()["extensions"] == ["binary_tensor_data"]
    for path in ("/v2/models/push-indicator", "/v2/models/push-indicator/versions/1"):
        assert client.get(path).json() == {
            "name": "push-indicator",
            "versions": ["1", "2"],
            "platform": "onnx_onnxv1",
            "inputs": [
                {"name": "pusher", "datatype": "FP32", "shape": [-1, 3]},
                {"name": "context", "datatype": "FP32", "shape": [-1, 36]},
                {"name": "context_index", "datatype": "INT64", "shape": [-1]},
            ],
            "outputs": [
                {"name": "mean", "datatype": "FP32", "shape": [-1, 3]},
                {"name": "std", "datatype": "FP32", "shape": [-1, 3]},
            ],
        }
        assert client.get(f"{path}/ready").json() == {"name": "push-indicator", "ready": True}


def test_without_a_model_nothing_is_ready(tmp_path: Path) -> None:
    """503, in the protocol's form."""
    models = LoadedModels(Registry(tmp_path / "nowhere"), load_fake)
    with TestClient(create_app(Settings(), models)) as client:
        error(client.get("/v2/health/ready"), 503)
        error(client.get("/v2/models/push-none/ready"), 503)
        assert client.get("/v2/health/live").status_code == 200


def test_a_version_can_be_asked_by_its_number_and_a_model_by_its_alias(client: TestClient) -> None:
    """The answer says which it was; without a version it is the champion."""
    asked = {
        URL: "1",
        "/v2/models/push-indicator/versions/2/infer": "2",
        "/v2/models/push-indicator@canary/infer": "2",
    }
    for path, version in asked.items():
        answer = client.post(path, json=document(id="42")).json()
        assert (answer["model_name"], answer["model_version"], answer["id"]) == ("push-indicator", version, "42")


def queued(client: TestClient) -> int:
    """How many requests went to a thread so far."""
    lines = client.get("/metrics").text.splitlines()
    return sum(int(float(line.split()[-1])) for line in lines if line.startswith("cazsl_queue_wait_seconds_count"))


@pytest.mark.parametrize("way", [{}, {"Content-Encoding": "identity"}], ids=["short", "long"])
@pytest.mark.parametrize(("pushes", "threads"), [(1, 0), (200, 0), (1000, 1)])
def test_many_pushes_leave_the_event_loop_in_either_form(
    client: TestClient, pushes: int, threads: int, way: dict[str, str]
) -> None:
    """Raw they are a fraction of the bytes, and as much work; and they get the numbers of few."""
    many = np.resize(PUSHES, (pushes, 3))
    content, header = packed(("pusher", many), ("context", INDICATOR[None]))
    nested = json.dumps(document(inputs=[tensor("pusher", many), tensor("context", INDICATOR[None])])).encode()
    expected = np.resize(numbers(client.post(URL, json=document()))["mean"], (pushes, 3)).tolist()
    for body, headers in ((content, header | way), (nested, way)):
        before = queued(client)
        assert numbers(client.post(URL, content=body, headers=headers))["mean"].tolist() == expected
        assert queued(client) - before == threads


def test_json_and_raw_tensors_get_the_same_numbers(client: TestClient) -> None:
    """Nested, flat or raw, in and out, and the same as /v1 gives."""
    flat = document()
    for part in flat["inputs"]:
        part["data"] = np.array(part["data"]).reshape(-1).tolist()
    raw = packed(("pusher", PUSHES), ("context", INDICATOR[None]), parameters={"binary_data_output": True})
    index = np.zeros(2, dtype=np.int64)
    mixed = packed(("context", INDICATOR[None]), ("context_index", index), ("pusher", PUSHES))
    found = [
        numbers(client.post(URL, json=document())),
        numbers(client.post(URL, json=flat)),
        numbers(client.post(URL, content=raw[0], headers=raw[1])),
        numbers(client.post(URL, content=mixed[0], headers=mixed[1])),
    ]
    body = {"pushers": PUSHES.tolist(), "contexts": [{"descriptor": "1a2b3c4a"}]}
    batch = client.post("/v1/predict/batch", json=body).json()
    for each in found:
        for name in ("mean", "std"):
            assert (each[name] == np.array(batch[name], dtype=np.float32)).all()


def test_the_flag_of_one_output_wins_over_that_of_all(client: TestClient) -> None:
    """And the outputs come in the order asked for, alone when asked alone."""
    wanted = [{"name": "std"}, {"name": "mean", "parameters": {"binary_data": False}}]
    response = client.post(URL, json=document(parameters={"binary_data_output": True}, outputs=wanted))
    head = json.loads(response.content[: int(response.headers[LENGTH])])
    assert [output["name"] for output in head["outputs"]] == ["std", "mean"]
    assert ["data" in output for output in head["outputs"]] == [False, True]
    assert response.headers["content-type"] == "application/octet-stream"
    assert list(numbers(client.post(URL, json=document(outputs=[{"name": "mean"}])))) == ["mean"]


@pytest.mark.parametrize("pack", [gzip.compress, zlib.compress], ids=["gzip", "deflate"])
def test_a_compressed_request_is_read(client: TestClient, pack: Any) -> None:
    """The length in the header counts the JSON as it is uncompressed."""
    content, headers = packed(("pusher", PUSHES), ("context", INDICATOR[None]))
    encoding = {"Content-Encoding": "gzip" if pack is gzip.compress else "deflate"}
    assert "mean" in numbers(client.post(URL, content=pack(content), headers=headers | encoding))


def test_a_compressed_request_is_read_up_to_the_limit_and_whole(client: TestClient) -> None:
    """A bomb, half a stream, two streams and another encoding."""
    bomb = gzip.compress(bytes(64 << 20))
    error(client.post(URL, content=bomb, headers={"Content-Encoding": "gzip"}), 413)
    whole = gzip.compress(json.dumps(document()).encode())
    for content in (whole[:-9], whole + whole, b"no gzip", b""):
        error(client.post(URL, content=content, headers={"Content-Encoding": "gzip"}))
    error(client.post(URL, content=whole, headers={"Content-Encoding": "br"}), 415)


def test_a_visual_model_takes_levels_rounded_to_eight_bits(client: TestClient) -> None:
    """As everywhere: the same levels as the 1,024 bytes of /v1."""
    grey = np.full((1, 1, 32, 32), 0.5, dtype=np.float32)
    inputs = [tensor("pusher", PUSHES), tensor("context", grey)]
    found = numbers(client.post("/v2/models/push-visual/infer", json={"inputs": inputs}))
    body = {"pushers": PUSHES.tolist(), "contexts": [{"visual": [[0.5] * 32] * 32}]}
    expected = client.post("/v1/predict/batch", json=body).json()["mean"]
    assert (found["mean"] == np.array(expected, dtype=np.float32)).all()
    too_bright = [tensor("pusher", PUSHES), tensor("context", grey * 3)]
    assert "[0, 1]" in error(client.post("/v2/models/push-visual/infer", json={"inputs": too_bright}))


def changed(place: int, **changes: Any) -> dict[str, Any]:
    """A request with one input changed."""
    found = document()
    found["inputs"][place] |= changes
    return found


TWO_SHAPES = INDICATOR.copy()
TWO_SHAPES[1] = 1.0
INDEX = tensor("context_index", np.array([0, 1], dtype=np.int64))
BAD: dict[str, tuple[Any, str]] = {
    "no inputs": ({}, "inputs"),
    "a list": ([], "body: received a list"),
    "unknown input": (document(inputs=[tensor("speed", PUSHES)]), "unknown or repeated tensor"),
    "unknown or repeated tensor": (document(inputs=[tensor("pusher", PUSHES)] * 2), "unknown or repeated tensor"),
    "no pusher": (document(inputs=[tensor("context", INDICATOR[None])]), "no tensor pusher"),
    "no context": (document(inputs=[tensor("pusher", PUSHES)]), "no tensor context"),
    "another type": (changed(0, datatype="FP64"), "FP32"),
    "an overflowing shape": (changed(0, shape=[2**60 + 2, 3]), "shape"),
    "a huge dimension": (changed(0, shape=[2**64, 3]), "shape"),
    "a negative shape": (changed(0, shape=[-2, 3]), "shape"),
    "an empty shape": (changed(0, shape=[0, 3], data=[]), "shape"),
    "another rank": (changed(0, shape=[6]), "shape"),
    "a short list": (changed(0, data=[0.0] * 5), "5 values"),
    "ragged rows": (changed(0, data=[[0.0, 0.0], [0.0] * 4]), "nest"),
    "deep rows": (changed(0, data=[[[0.0]] * 3] * 2), "not a number of this type"),
    "text": (changed(0, data=["0"] * 6), "not a number of this type"),
    "truth": (changed(0, data=[True] * 6), "not a number of this type"),
    "null": (changed(0, data=[None] * 6), "not a number of this type"),
    "not finite": (changed(0, data=[float("nan")] * 6), "pusher[0, 0]"),
    "beyond float32": (changed(0, data=[0, 0, 0, 0, 0, 1e300]), "pusher[1, 2]"),
    "a huge integer": (changed(0, data=[10**400] * 6), ""),
    "out of reach": (changed(0, data=[0, 0, 0, 0, 1.5, 0]), "pusher[1]"),
    "two shapes": (changed(1, data=TWO_SHAPES[None].tolist()), "inputs context[0] side 1"),
    "no such place": ({"inputs": [*document()["inputs"], INDEX]}, "context_index"),
    "a short index": (
        {"inputs": [*document()["inputs"], INDEX | {"shape": [1], "data": [0]}]},
        "2 values: one per push",
    ),
    "three contexts": (changed(1, shape=[3, 36], data=[INDICATOR.tolist()] * 3), "3 contexts"),
    "unknown output": (document(outputs=[{"name": "covariance"}]), "outputs"),
    "raw and missing": (changed(0, data=None, parameters={"binary_data_size": 24}), "0 bytes"),
    "neither": (changed(0, data=None), "neither"),
}


@pytest.mark.parametrize("name", BAD)
def test_a_bad_request_is_a_400_that_says_where(client: TestClient, name: str) -> None:
    """Every one of the traps that brought other servers down."""
    body, words = BAD[name]
    text = error(client.post(URL, content=json.dumps(body)))
    assert words in text
    assert client.get("/v2/health/live").status_code == 200


@pytest.mark.parametrize("length", ["-1", "x", "0", "1e2", "999999", "9" * 40, "", "٣", "3"])
def test_a_length_that_does_not_fit_is_refused(client: TestClient, length: str) -> None:
    """Negative, no number, zero, beyond the body, in the middle of the JSON."""
    content, _ = packed(("pusher", PUSHES), ("context", INDICATOR[None]))
    error(client.post(URL, content=content, headers={LENGTH.encode(): length.encode()}))


def test_raw_bytes_must_be_exactly_those_of_the_tensors(client: TestClient) -> None:
    """Nothing missing, nothing left over, and the sizes those of the shapes."""
    content, headers = packed(("pusher", PUSHES), ("context", INDICATOR[None]))
    assert "143 bytes" in error(client.post(URL, content=content[:-1], headers=headers))
    assert "1 bytes after" in error(client.post(URL, content=content + b"\0", headers=headers))
    for size in (23, 25, -24, 2**63, "24", True, 24.0):
        body = changed(0, data=None, parameters={"binary_data_size": size})
        head = json.dumps(body).encode()
        response = client.post(URL, content=head + bytes(24), headers={LENGTH: str(len(head))})
        assert response.status_code == (200 if size == 24 and not isinstance(size, bool) else 400), size


def test_what_is_not_there_is_a_404_in_the_protocols_form(client: TestClient) -> None:
    """Model, version, route and method."""
    for path in (
        "/v2/models/nobody",
        "/v2/models/push-none/versions/9/ready",
        "/v2/nothing",
        "/v2/models/nobody/ready",
    ):
        error(client.get(path), 404)
    error(client.post("/v2/models/nobody/infer", json=document()), 404)
    error(client.get("/v2/models/push-none/versions/0/ready"))
    error(client.get("/v2/models/..%2Fetc/ready"), 404)
    error(client.get(URL), 405)
    error(client.post(URL, content=bytes((1 << 20) + 1)), 413)


heads = st.fixed_dictionaries(
    {
        "inputs": st.lists(
            st.fixed_dictionaries(
                {
                    "name": st.sampled_from(["pusher", "context", "context_index", "?"]),
                    "shape": st.lists(st.sampled_from([1, 2, 3, 36, 0, -1, 2**62]), min_size=1, max_size=4),
                    "datatype": st.sampled_from(["FP32", "INT64", "BYTES"]),
                },
                optional={
                    "data": st.lists(st.floats() | st.integers() | st.lists(st.floats(), max_size=3), max_size=6),
                    "parameters": st.fixed_dictionaries({"binary_data_size": st.integers(-1, 200)}),
                },
            ),
            max_size=4,
        )
    }
)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None, max_examples=500)
@given(heads, st.binary(max_size=300), st.integers(-3, 3))
def test_no_tensors_get_a_5xx(client: TestClient, head: Any, raw: bytes, off: int) -> None:
    """Sizes, shapes and bytes that do not belong together: an answer or a 400."""
    text = json.dumps(head).encode()
    response = client.post(URL, content=text + raw, headers={LENGTH: str(len(text) + off)})
    assert response.status_code in (200, 400), response.text


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None, max_examples=500)
@given(st.integers(0, 500), st.integers(0, 500), st.binary(max_size=20))
def test_no_broken_request_gets_a_5xx(client: TestClient, start: int, end: int, noise: bytes) -> None:
    """A good binary request with a piece replaced."""
    content, headers = packed(("pusher", PUSHES), ("context", INDICATOR[None]))
    response = client.post(URL, content=content[:start] + noise + content[end:], headers=headers)
    assert response.status_code in (200, 400), response.text
