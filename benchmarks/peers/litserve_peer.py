"""Server with LitServe and the model, one worker: pip install litserve onnxruntime numpy in its own environment."""

import sys
from typing import Any

import litserve
import numpy as np
import onnxruntime


class Pushes(litserve.LitAPI):  # type: ignore[misc]  # the peer is not installed where types are checked
    """A prediction in the steps of LitServe."""

    def setup(self, device: str) -> None:
        """Load the model."""
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        self._session = onnxruntime.InferenceSession("models/push-indicator/1/model.onnx", options)

    def decode_request(self, request: dict[str, Any]) -> dict[str, Any]:
        """Convert JSON to arrays."""
        text, bits = request["context"]["descriptor"], np.zeros((1, 36), dtype=np.float32)
        for side in range(4):
            bits[0, 9 * side + "1234".index(text[2 * side])] = 1.0
            bits[0, 9 * side + 4 + "abcBC".index(text[2 * side + 1])] = 1.0
        push = request["pusher"]
        pusher = np.array([[push["x"], push["y"], push["angle"]]], dtype=np.float32)
        return {"pusher": pusher, "context": bits, "context_index": np.zeros(1, dtype=np.int64)}

    def predict(self, feed: dict[str, Any]) -> Any:
        """Run the model."""
        return self._session.run(("mean", "std"), feed)

    def encode_response(self, output: Any) -> dict[str, list[float]]:
        """Convert arrays to JSON."""
        return {"mean": output[0][0].tolist(), "std": output[1][0].tolist()}


if __name__ == "__main__":
    server = litserve.LitServer(Pushes(api_path="/v1/predict"), accelerator="cpu", workers_per_device=1)
    server.run(host="127.0.0.1", port=int(sys.argv[1]), num_api_servers=1, generate_client_file=False)
