"""Third-party clients against a service process: those of HTTP, tritonclient, blocking and asyncio, and KServe's SDK.

KServe's SDK needs another protobuf than the trainer's onnx, and so an environment of its own. KSERVE_PYTHON is its
interpreter (``python -m venv kserve && kserve/bin/pip install kserve==0.21.0``).
"""

import asyncio
import json
import os
import subprocess
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from http.client import HTTPConnection
from pathlib import Path
from typing import Any

import httpx2
import numpy as np
import pytest
import tritonclient.http as blocking
import tritonclient.http.aio as concurrent
from tritonclient.utils import InferenceServerException

from service.pushing.contexts import ObjectContext
from service.registry.registry import Registry
from tests.http_clients import PROGRAMS, is_installed, posted
from tests.running_service import ROOT, serve

KSERVE = os.environ.get("KSERVE_PYTHON")

PUSHES = np.array([[-0.075, 0.0, 0.0], [0.0, -0.075, 1.5708]], dtype=np.float32)
CONTEXT = ObjectContext.from_descriptor("1a2b3c4a").indicator()[None]
INDEX = np.zeros(2, dtype=np.int64)
SHIPPED = Registry(ROOT / "models")
CHAMPION = str(SHIPPED.aliases("push-indicator")["champion"])


PUSH = b'{"pusher": {"x": -0.075, "y": 0.0, "angle": 0.0}, "context": {"descriptor": "1a2b3c4a"}}'
JSON = {"Content-Type": "application/json"}
TOO_LARGE = b" " * (16 << 20)  # more than a body may have, and more than a kernel takes at once


@pytest.fixture(scope="module")
def url(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """Run a service. Return its host and port."""
    with serve(tmp_path_factory.mktemp("clients")) as (port, _):
        yield f"127.0.0.1:{port}"


@pytest.fixture(scope="module")
def client(url: str) -> Iterator[blocking.InferenceServerClient]:
    """Return the blocking client of the service."""
    with blocking.InferenceServerClient(url) as found:
        yield found


def inputs(module: Any, *, binary: bool = True) -> list[Any]:
    """Create the input tensors of two pushes of one object, in the classes of a client."""
    found = []
    for name, array in (("pusher", PUSHES), ("context", CONTEXT), ("context_index", INDEX)):
        tensor = module.InferInput(name, list(array.shape), "INT64" if array.dtype == np.int64 else "FP32")
        tensor.set_data_from_numpy(array, binary_data=binary)
        found.append(tensor)
    return found


def test_health_and_metadata(client: blocking.InferenceServerClient) -> None:
    """The client reads health, readiness per model, and the metadata of the server and of a model."""
    assert client.is_server_live()
    assert client.is_server_ready()
    assert client.is_model_ready("push-indicator")
    assert client.is_model_ready("push-indicator", CHAMPION)
    assert not client.is_model_ready("push-indicator", "9")
    assert not client.is_model_ready("nobody")
    assert client.get_server_metadata()["name"] == "cazsl"
    metadata = client.get_model_metadata("push-indicator")
    assert metadata["versions"] == [str(version) for version in SHIPPED.versions("push-indicator")]
    assert [tensor["name"] for tensor in metadata["inputs"]] == ["pusher", "context", "context_index"]


@pytest.mark.parametrize("binary_in", [True, False], ids=["binary in", "JSON in"])
@pytest.mark.parametrize("binary_out", [True, False], ids=["binary out", "JSON out"])
@pytest.mark.parametrize("packed", [None, "gzip", "deflate"])
def test_inference_in_every_form(
    client: blocking.InferenceServerClient, binary_in: bool, binary_out: bool, packed: str | None
) -> None:
    """Every form of inference gives the same numbers: binary or JSON, in and out, compressed or not."""
    outputs = [blocking.InferRequestedOutput(name, binary_data=binary_out) for name in ("mean", "std")]
    result = client.infer(
        "push-indicator",
        inputs(blocking, binary=binary_in),
        model_version=CHAMPION,
        outputs=outputs,
        request_id="42",
        request_compression_algorithm=packed,
        response_compression_algorithm=packed,
    )
    plain = client.infer("push-indicator", inputs(blocking))
    for name in ("mean", "std"):
        assert (result.as_numpy(name) == plain.as_numpy(name)).all()
    assert result.as_numpy("mean").shape == (2, 3)
    assert (result.as_numpy("std") > 0).all()
    response = result.get_response()
    assert (response["model_name"], response["model_version"], response["id"]) == ("push-indicator", CHAMPION, "42")


def test_a_visual_model_predicts_from_an_image_tensor(client: blocking.InferenceServerClient) -> None:
    """A visual model takes its images as a tensor, as any other model takes its context."""
    pusher, context = (
        blocking.InferInput("pusher", [2, 3], "FP32"),
        blocking.InferInput("context", [1, 1, 32, 32], "FP32"),
    )
    pusher.set_data_from_numpy(PUSHES)
    context.set_data_from_numpy(np.full((1, 1, 32, 32), 51 / 255, dtype=np.float32))
    mean = client.infer("push-visual", [pusher, context]).as_numpy("mean")
    assert mean == pytest.approx(-PUSHES / 10 + np.array([0.0, 0.0, 0.2]), abs=1e-6)


@pytest.mark.parametrize("name", ["nobody", "push-visual"])
def test_an_error_reaches_the_user_of_a_client(client: blocking.InferenceServerClient, name: str) -> None:
    """The client shows the text of an error, of an unknown model and of a model with other tensors."""
    with pytest.raises(InferenceServerException) as raised:
        client.infer(name, inputs(blocking))
    assert "accepted is" in str(raised.value)
    assert raised.value.status() in ("404", "400")


def test_numbers_that_are_not_finite_are_refused_by_tensor_and_row(client: blocking.InferenceServerClient) -> None:
    """NaN is refused with its tensor and position, in binary and in JSON. The client sends it in both."""
    for binary in (True, False):
        tensors = inputs(blocking, binary=binary)
        tensors[0].set_data_from_numpy(np.full((2, 3), np.nan, dtype=np.float32), binary_data=binary)
        with pytest.raises(InferenceServerException, match=r"inputs pusher\[0, 0\]"):
            client.infer("push-indicator", tensors)


def test_the_asyncio_client_works(url: str) -> None:
    """The asyncio client reads health and metadata, sends 20 concurrent requests and shows the text of an error."""

    async def scenario() -> None:
        """Ask every question of the protocol."""
        async with concurrent.InferenceServerClient(url) as client:
            assert await client.is_server_live()
            assert await client.is_server_ready()
            assert await client.is_model_ready("push-indicator")
            assert (await client.get_server_metadata())["extensions"] == ["binary_tensor_data"]
            assert CHAMPION in (await client.get_model_metadata("push-indicator", CHAMPION))["versions"]
            tensors = inputs(concurrent)
            results = await asyncio.gather(
                *(client.infer("push-indicator", tensors, request_compression_algorithm="gzip") for _ in range(20))
            )
            first = results[0].as_numpy("mean")
            assert all((result.as_numpy("mean") == first).all() for result in results)
            with pytest.raises(InferenceServerException, match="accepted is"):
                await client.infer("nobody", tensors)

    asyncio.run(scenario())


@pytest.fixture(scope="module")
def programs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of the compiled programs."""
    return tmp_path_factory.mktemp("programs")


@pytest.mark.parametrize("program", PROGRAMS)
def test_a_program_of_another_language_reads_its_answers(url: str, programs: Path, program: str) -> None:
    """Its defaults work, an offered upgrade among them, and so does the answer to a body that is refused early."""
    if not is_installed(program):
        pytest.skip(f"{program} is not installed")
    for body, status in ((PUSH, 200), (TOO_LARGE, 413)):
        answers = posted(program, programs, f"http://{url}/v1/predict", body, JSON, turns=2)
        assert [found for found, _ in answers] == [status] * 2
        assert ("mean" in json.loads(answers[0][1])) is (status == 200)


def by_urllib(url: str, body: bytes) -> list[int]:
    """Send a body twice with urllib, and read the answers. Return the statuses."""
    request = urllib.request.Request(url, body, JSON)  # noqa: S310  # a service of ours
    statuses = []
    for _ in range(2):
        try:
            answer = urllib.request.urlopen(request, timeout=60)  # noqa: S310
        except urllib.error.HTTPError as error:
            answer = error
        with answer:
            json.load(answer)
            statuses.append(answer.status)
    return statuses


def by_http_client(url: str, body: bytes) -> list[int]:
    """Send a body twice with http.client, which sends all of it before it reads. Return the statuses."""
    connection = HTTPConnection(url.split("/")[2], timeout=60)
    statuses = []
    for _ in range(2):
        connection.request("POST", "/v1/predict", body, JSON)
        answer = connection.getresponse()
        json.loads(answer.read())
        statuses.append(answer.status)
    connection.close()
    return statuses


def by_httpx(url: str, body: bytes) -> list[int]:
    """Send a body twice with httpx2. Return the statuses."""
    with httpx2.Client(timeout=60) as client:
        return [client.post(url, content=body, headers=JSON).status_code for _ in range(2)]


@pytest.mark.parametrize("send", [by_urllib, by_http_client, by_httpx])
def test_a_library_of_python_reads_its_answers(url: str, send: Callable[[str, bytes], list[int]]) -> None:
    """A library that sends a whole body before it reads gets the answer to a body that is refused early."""
    assert send(f"http://{url}/v1/predict", PUSH) == [200, 200]
    assert send(f"http://{url}/v1/predict", TOO_LARGE) == [413, 413]


@pytest.mark.skipif(
    KSERVE is None,
    reason="kserve needs protobuf < 7: KSERVE_PYTHON names no interpreter with it",
)
def test_the_sdk_of_kserve_works(url: str) -> None:
    """KServe's SDK reads health, runs inference in JSON and binary, and shows the text of an error."""
    script = str(ROOT / "tests" / "kserve_client.py")
    bits = "".join(str(int(bit)) for bit in CONTEXT[0])
    done = subprocess.run([KSERVE or "", script, f"http://{url}", bits], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
