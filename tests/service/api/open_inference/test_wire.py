"""Tensors are read from JSON and raw bytes with the expected types, shapes and sizes, or refused by field."""

import json
from typing import Any

import numpy as np
import pytest
from fastapi.testclient import TestClient
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from service.api.open_inference.wire import read_inputs, read_json, render
from service.errors import MalformedBodyError
from service.model.tensors import ContextKind
from service.pushing.onnx_interface import expected_inputs
from tests.service.api.open_inference.tensors import (
    INDICATOR,
    LENGTH,
    PUSHES,
    URL,
    changed,
    document,
    error,
    numbers,
    packed,
    tensor,
)


def test_json_and_raw_tensors_get_the_same_numbers(client: TestClient) -> None:
    """Nested, flat and raw tensors get the same numbers, which are those of /v1."""
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


BAD: dict[str, tuple[Any, str]] = {
    "no inputs": ({}, "inputs"),
    "a list": ([], "body: received a list"),
    "unknown input": (document(inputs=[tensor("speed", PUSHES)]), "unknown or repeated tensor"),
    "unknown or repeated tensor": (document(inputs=[tensor("pusher", PUSHES)] * 2), "unknown or repeated tensor"),
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
    "raw and missing": (changed(0, data=None, parameters={"binary_data_size": 24}), "0 bytes"),
    "neither": (changed(0, data=None), "neither"),
}


@pytest.mark.parametrize("name", BAD)
def test_a_faulty_tensor_is_a_400_that_names_its_field(client: TestClient, name: str) -> None:
    """A faulty tensor is refused with its field, and the service stays alive."""
    body, words = BAD[name]
    text = error(client.post(URL, content=json.dumps(body)))
    assert words in text
    assert client.get("/v2/health/live").status_code == 200


@pytest.mark.parametrize("length", ["-1", "x", "0", "1e2", "999999", "9" * 40, "", "٣", "3"])
def test_a_length_that_does_not_fit_is_refused(client: TestClient, length: str) -> None:
    """A length of the JSON that is not a positive number within the body, or not its length, is refused."""
    content, _ = packed(("pusher", PUSHES), ("context", INDICATOR[None]))
    error(client.post(URL, content=content, headers={LENGTH.encode(): length.encode()}))


def test_raw_bytes_must_be_exactly_those_of_the_tensors(client: TestClient) -> None:
    """Raw bytes have exactly the sizes of the shapes, and no byte follows them."""
    content, headers = packed(("pusher", PUSHES), ("context", INDICATOR[None]))
    assert "143 bytes" in error(client.post(URL, content=content[:-1], headers=headers))
    assert "1 bytes after" in error(client.post(URL, content=content + b"\0", headers=headers))
    for size in (23, 25, -24, 2**63, "24", True, 24.0):
        body = changed(0, data=None, parameters={"binary_data_size": size})
        head = json.dumps(body).encode()
        response = client.post(URL, content=head + bytes(24), headers={LENGTH: str(len(head))})
        assert response.status_code == (200 if size == 24 and not isinstance(size, bool) else 400), size


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
    """Sizes, shapes and bytes that do not fit each other get an answer or a 400."""
    text = json.dumps(head).encode()
    response = client.post(URL, content=text + raw, headers={LENGTH: str(len(text) + off)})
    assert response.status_code in (200, 400), response.text


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None, max_examples=500)
@given(st.integers(0, 500), st.integers(0, 500), st.binary(max_size=20))
def test_no_broken_request_gets_a_5xx(client: TestClient, start: int, end: int, noise: bytes) -> None:
    """A request with raw tensors with a piece replaced by noise gets an answer or a 400."""
    content, headers = packed(("pusher", PUSHES), ("context", INDICATOR[None]))
    response = client.post(URL, content=content[:start] + noise + content[end:], headers=headers)
    assert response.status_code in (200, 400), response.text


def test_rendered_outputs_are_read_again() -> None:
    """Outputs as raw bytes follow the JSON in its order, and their header has the length of the JSON."""
    arrays = {"pusher": PUSHES, "context": INDICATOR[None]}
    content, headers = render({"id": "7"}, arrays, frozenset(arrays))
    length = int(dict(headers)[b"inference-header-content-length"])
    head = json.loads(content[:length])
    assert [output["name"] for output in head["outputs"]] == ["pusher", "context"]
    body = json.dumps({"inputs": head["outputs"]}).encode()
    parsed, raw = read_json(body + content[length:], str(len(body)))
    found = read_inputs(parsed, raw, expected_inputs(ContextKind.INDICATOR))
    assert all((found[name] == array).all() for name, array in arrays.items())


def test_outputs_in_json_have_no_header_of_a_length() -> None:
    """An answer without raw bytes is plain JSON with flat numbers."""
    content, headers = render({"id": "7"}, {"mean": PUSHES}, frozenset())
    assert dict(headers) == {b"content-type": b"application/json"}
    (output,) = json.loads(content)["outputs"]
    assert (output["shape"], len(output["data"])) == ([2, 3], 6)


def test_a_length_beyond_the_body_is_malformed() -> None:
    """The JSON of a request cannot be longer than its body."""
    with pytest.raises(MalformedBodyError, match="1 to 2 bytes"):
        read_json(b"{}", "3")
