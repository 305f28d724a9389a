"""Server with BentoML and the model, one worker: pip install bentoml onnxruntime numpy in its own environment.

Its server is a process that supervises the worker. The worker imports this file by its name.
"""

import os
import sys
from pathlib import Path
from typing import Any

import bentoml
import numpy as np
import onnxruntime

FOLDER = Path(__file__).resolve().parent


@bentoml.service(workers=1)
class Pushes:
    """A model that predicts one push at a time."""

    def __init__(self) -> None:
        """Load the model."""
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        model = FOLDER.parents[1] / "models/push-indicator/1/model.onnx"
        self._session = onnxruntime.InferenceSession(str(model), options)

    @bentoml.api(route="/v1/predict")  # type: ignore[untyped-decorator]  # the peer is not installed where types are checked
    async def predict(self, pusher: dict[str, float], context: dict[str, Any]) -> dict[str, list[float]]:
        """Predict one push."""
        text, bits = context["descriptor"], np.zeros((1, 36), dtype=np.float32)
        for side in range(4):
            bits[0, 9 * side + "1234".index(text[2 * side])] = 1.0
            bits[0, 9 * side + 4 + "abcBC".index(text[2 * side + 1])] = 1.0
        pose = np.array([[pusher["x"], pusher["y"], pusher["angle"]]], dtype=np.float32)
        feed = {"pusher": pose, "context": bits, "context_index": np.zeros(1, dtype=np.int64)}
        mean, std = self._session.run(("mean", "std"), feed)
        return {"mean": mean[0].tolist(), "std": std[0].tolist()}


if __name__ == "__main__":
    command = [sys.executable, "-m", "bentoml", "serve", "bentoml_peer:Pushes", "--working-dir", str(FOLDER)]
    options = ["--host", "127.0.0.1", "--port", sys.argv[1], "--quiet"]
    os.execve(sys.executable, [*command, *options], {**os.environ, "BENTOML_DO_NOT_TRACK": "True"})  # noqa: S606
