"""Server with MLServer and the model, in process: pip install mlserver onnxruntime numpy in its own environment.

Its own protocol has other bodies, so the benchmark uses a route that its ``custom_handler`` adds to the same REST
server. Its gRPC server cannot be switched off. It listens on another port and gets no requests.
"""

import asyncio
import socket
import sys
from typing import Any

import mlserver
import numpy as np
import onnxruntime
from mlserver.handlers import custom_handler
from mlserver.server import MLServer


class Pushes(mlserver.MLModel):  # type: ignore[misc]  # the peer is not installed where types are checked
    """A model that predicts one push at a time."""

    async def load(self) -> bool:
        """Load the model."""
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        self._session = onnxruntime.InferenceSession("models/push-indicator/1/model.onnx", options)
        return True

    @custom_handler(rest_path="/v1/predict")  # type: ignore[untyped-decorator]
    async def push(self, request: dict[str, Any]) -> dict[str, list[float]]:
        """Predict one push."""
        text, bits = request["context"]["descriptor"], np.zeros((1, 36), dtype=np.float32)
        for side in range(4):
            bits[0, 9 * side + "1234".index(text[2 * side])] = 1.0
            bits[0, 9 * side + 4 + "abcBC".index(text[2 * side + 1])] = 1.0
        push = request["pusher"]
        pusher = np.array([[push["x"], push["y"], push["angle"]]], dtype=np.float32)
        feed = {"pusher": pusher, "context": bits, "context_index": np.zeros(1, dtype=np.int64)}
        mean, std = self._session.run(("mean", "std"), feed)
        return {"mean": mean[0].tolist(), "std": std[0].tolist()}


async def serve(port: int) -> None:
    """Serve on a port until the process ends."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        grpc_port = probe.getsockname()[1]
    settings = mlserver.Settings(
        debug=False,
        parallel_workers=0,
        host="127.0.0.1",
        http_port=port,
        grpc_port=grpc_port,
        metrics_endpoint=None,
        load_models_at_startup=False,
    )
    await MLServer(settings).start([mlserver.ModelSettings(name="pushes", implementation=Pushes)])


if __name__ == "__main__":
    asyncio.run(serve(int(sys.argv[1])))
