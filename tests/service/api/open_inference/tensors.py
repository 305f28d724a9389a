"""Inference requests in JSON and with raw tensors, and the numbers of their answers."""

import json
from typing import Any

import numpy as np
from httpx2 import Response

from service.pushing.contexts import ObjectContext

INDICATOR = ObjectContext.from_descriptor("1a2b3c4a").indicator()
PUSHES = np.array([[0.1, 0.0, 0.0], [0.2, 0.05, 4.0]], dtype=np.float32)
URL = "/v2/models/push-indicator/infer"
LENGTH = "Inference-Header-Content-Length"


def tensor(name: str, array: np.ndarray[Any, Any], **changes: Any) -> dict[str, Any]:
    """Return a tensor in JSON, nested."""
    datatype = "INT64" if array.dtype == np.int64 else "FP32"
    return {"name": name, "shape": list(array.shape), "datatype": datatype, "data": array.tolist()} | changes


def document(**changes: Any) -> dict[str, Any]:
    """Return a valid request, with these changes."""
    return {"inputs": [tensor("pusher", PUSHES), tensor("context", INDICATOR[None])]} | changes


def changed(place: int, **changes: Any) -> dict[str, Any]:
    """Return a valid request with changes of one input."""
    found = document()
    found["inputs"][place] |= changes
    return found


def packed(*arrays: tuple[str, np.ndarray[Any, Any]], **changes: Any) -> tuple[bytes, dict[str, str]]:
    """Return a request with raw tensors, and its header."""
    inputs = [tensor(name, array, parameters={"binary_data_size": array.nbytes}) for name, array in arrays]
    for part in inputs:
        del part["data"]
    head = json.dumps({"inputs": inputs} | changes).encode()
    return head + b"".join(array.tobytes() for _, array in arrays), {LENGTH: str(len(head))}


def error(response: Response, status: int = 400) -> str:
    """Return the text of an error, and check its form and status."""
    assert response.status_code == status, response.text
    assert response.headers["content-type"] == "application/json"
    assert set(response.json()) == {"error"}
    text = response.json()["error"]
    assert isinstance(text, str)
    return text


def numbers(response: Response) -> dict[str, np.ndarray[Any, Any]]:
    """Return the outputs of an answer by name, from JSON or raw bytes."""
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
