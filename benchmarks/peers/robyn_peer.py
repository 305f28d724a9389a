"""Server with Robyn and the model, one process: pip install robyn onnxruntime numpy in its own environment."""

import json
import sys

import numpy as np
import onnxruntime
from robyn import Request, Robyn

options = onnxruntime.SessionOptions()
options.intra_op_num_threads = options.inter_op_num_threads = 1
session = onnxruntime.InferenceSession("models/push-indicator/1/model.onnx", options)
app = Robyn(__file__)


@app.post("/v1/predict")  # type: ignore[untyped-decorator]  # the peer is not installed where types are checked
async def predict(request: Request) -> dict[str, list[float]]:
    """Predict one push."""
    document = json.loads(request.body)
    text, bits = document["context"]["descriptor"], np.zeros((1, 36), dtype=np.float32)
    for side in range(4):
        bits[0, 9 * side + "1234".index(text[2 * side])] = 1.0
        bits[0, 9 * side + 4 + "abcBC".index(text[2 * side + 1])] = 1.0
    push = document["pusher"]
    pusher = np.array([[push["x"], push["y"], push["angle"]]], dtype=np.float32)
    feed = {"pusher": pusher, "context": bits, "context_index": np.zeros(1, dtype=np.int64)}
    mean, std = session.run(("mean", "std"), feed)
    return {"mean": mean[0].tolist(), "std": std[0].tolist()}


if __name__ == "__main__":
    app.start(host="127.0.0.1", port=int(sys.argv[1]))
