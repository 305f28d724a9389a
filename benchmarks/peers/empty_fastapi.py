"""Server (a): an empty FastAPI endpoint with our schemas. It parses the same request and renders the same answer."""

import sys

import uvicorn
from fastapi import FastAPI

from service.schemas.predictions import PredictResponse
from service.schemas.pushes import PredictRequest

ANSWER = PredictResponse.model_validate(
    {
        "model": {"name": "push-indicator", "version": 1},
        "frame": "object",
        "mean": {"x": 0.026867030516266823, "y": 0.000977544579654932, "angle": 0.04581319913268089},
        "std": {"x": 0.004548678174614906, "y": 0.0024233844596892595, "angle": 0.1610754281282425},
    }
)
app = FastAPI()


@app.post("/v1/predict")
async def predict(body: PredictRequest) -> PredictResponse:
    """Return a constant answer."""
    return ANSWER


if __name__ == "__main__":
    uvicorn.run(app, port=int(sys.argv[1]), log_config=None, access_log=False, server_header=False)
