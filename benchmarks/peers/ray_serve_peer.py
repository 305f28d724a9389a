"""Server with Ray Serve and the model, one replica: pip install 'ray[serve]' onnxruntime numpy in its own environment.

It starts several processes (scheduler, controller, proxy, replica), and all of them are counted. By default it listens
on every address, as a part of a cluster. Here it listens on 127.0.0.1 only.
"""

import importlib
import os
import signal
import sys
from typing import Any

os.environ |= {"RAY_USAGE_STATS_ENABLED": "0", "RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER": "0"}  # ray reads them at import

import numpy as np
import onnxruntime
import ray
from ray import serve
from starlette.requests import Request

MODEL = os.path.realpath("models/push-indicator/1/model.onnx")


class Pushes:
    """A model that predicts one push at a time."""

    def __init__(self, model: str) -> None:
        """Load the model."""
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        self._session = onnxruntime.InferenceSession(model, options)

    async def __call__(self, request: Request) -> dict[str, list[float]]:
        """Predict one push."""
        document = await request.json()
        text, bits = document["context"]["descriptor"], np.zeros((1, 36), dtype=np.float32)
        for side in range(4):
            bits[0, 9 * side + "1234".index(text[2 * side])] = 1.0
            bits[0, 9 * side + 4 + "abcBC".index(text[2 * side + 1])] = 1.0
        push = document["pusher"]
        pusher = np.array([[push["x"], push["y"], push["angle"]]], dtype=np.float32)
        feed = {"pusher": pusher, "context": bits, "context_index": np.zeros(1, dtype=np.int64)}
        mean, std = self._session.run(("mean", "std"), feed)
        return {"mean": mean[0].tolist(), "std": std[0].tolist()}


def stay_on_this_machine() -> None:
    """Make a replica's gRPC server listen on 127.0.0.1, for which it has no setting."""
    replica: Any = importlib.import_module("ray.serve._private.replica")
    add_port = replica.add_port_to_grpc_server
    replica.add_port_to_grpc_server = lambda server, _: add_port(server, "127.0.0.1:0")


if __name__ == "__main__":
    environment = {"worker_process_setup_hook": stay_on_this_machine}
    ray.init(address="local", num_cpus=1, include_dashboard=False, log_to_driver=False, runtime_env=environment)
    signal.signal(
        signal.SIGTERM, lambda *_: sys.exit()
    )  # ray's own handler aborts; sys.exit ends the processes that it started
    serve.start(http_options={"host": "127.0.0.1", "port": int(sys.argv[1])})
    one_replica = serve.deployment(num_replicas=1, ray_actor_options={"num_cpus": 1})(Pushes)
    serve.run(one_replica.bind(MODEL), route_prefix="/v1/predict")
    signal.pause()
