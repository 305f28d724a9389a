"""Script that calls a service with KServe's inference SDK. The SDK needs an environment of its own.

python tests/kserve_client.py URL INDICATOR
"""

import asyncio
import sys
from typing import Any

import httpx
import numpy as np
from kserve import InferenceRESTClient, InferInput, InferRequest, RESTConfig

MODEL = "push-indicator"


async def main(url: str, indicator: str) -> None:
    """Call health, inference in JSON and binary, and an unknown model. A wrong answer fails an assertion."""
    client = InferenceRESTClient(RESTConfig(protocol="v2", retries=1))
    assert await client.is_server_live(url)
    assert await client.is_server_ready(url)
    assert await client.is_model_ready(url, MODEL)
    arrays: dict[str, np.ndarray[Any, Any]] = {
        "pusher": np.array([[-0.075, 0.0, 0.0], [0.0, -0.075, 1.5]], dtype=np.float32),
        "context": np.array([[float(bit) for bit in indicator]], dtype=np.float32),
        "context_index": np.zeros(2, dtype=np.int64),
    }
    answers = []
    for binary in (True, False):
        inputs = []
        for name, array in arrays.items():
            tensor = InferInput(name, list(array.shape), "INT64" if array.dtype == np.int64 else "FP32")
            tensor.set_data_from_numpy(array, binary_data=binary)
            inputs.append(tensor)
        request = InferRequest(model_name=MODEL, infer_inputs=inputs, request_id="42")
        response = await client.infer(url, request, model_name=MODEL)
        assert (response.model_name, response.id) == (MODEL, "42")
        answers.append([output.as_numpy() for output in response.outputs])
    assert all((one == other).all() for one, other in zip(*answers, strict=True))
    assert [output.shape for output in answers[0]] == [(2, 3), (2, 3)]
    message = ""
    try:
        await client.infer(url, InferRequest(model_name="nobody", infer_inputs=inputs), model_name="nobody")
    except httpx.HTTPStatusError as error:
        message = str(error)
    assert "accepted is" in message


if __name__ == "__main__":
    asyncio.run(main(*sys.argv[1:]))
