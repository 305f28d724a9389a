"""Server (b): FastAPI and onnxruntime in thirty lines, without checks, limits and log."""

import sys

import numpy as np
import onnxruntime
import uvicorn
from fastapi import FastAPI
from pydantic import BaseModel

options = onnxruntime.SessionOptions()
options.intra_op_num_threads = options.inter_op_num_threads = 1
session = onnxruntime.InferenceSession("models/push-indicator/1/model.onnx", options)
app = FastAPI()


class Push(BaseModel):
    """A push of one object."""

    pusher: dict[str, float]
    context: dict[str, str]


@app.post("/v1/predict")
async def predict(push: Push) -> dict[str, list[float]]:
    """Predict one push."""
    text, bits = push.context["descriptor"], np.zeros((1, 36), dtype=np.float32)
    for side in range(4):
        bits[0, 9 * side + "1234".index(text[2 * side])] = 1.0
        bits[0, 9 * side + 4 + "abcBC".index(text[2 * side + 1])] = 1.0
    pusher = np.array([[push.pusher["x"], push.pusher["y"], push.pusher["angle"]]], dtype=np.float32)
    feed = {"pusher": pusher, "context": bits, "context_index": np.zeros(1, dtype=np.int64)}
    mean, std = session.run(("mean", "std"), feed)
    return {"mean": mean[0].tolist(), "std": std[0].tolist()}


if __name__ == "__main__":
    uvicorn.run(app, port=int(sys.argv[1]), log_config=None, access_log=False)
