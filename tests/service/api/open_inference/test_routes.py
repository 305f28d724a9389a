"""Routes of the Open Inference Protocol: health, metadata and errors."""

from pathlib import Path

from fastapi.testclient import TestClient

from service.app import create_app
from service.inference.loaded_models import LoadedModels
from service.registry.registry import Registry
from service.settings import Settings
from tests.fakes import load_fake
from tests.service.api.open_inference.tensors import URL, document, error


def test_health_and_metadata_have_the_form_of_the_protocol(client: TestClient) -> None:
    """Health, server and model metadata have the fields that clients read first."""
    assert client.get("/v2/health/live").json() == {"live": True}
    assert client.get("/v2/health/ready").json() == {"live": True, "ready": True}
    assert client.get("/v2").json()["name"] == "cazsl"
    assert client.get("/v2").json()["extensions"] == ["binary_tensor_data"]
    for path in ("/v2/models/push-indicator", "/v2/models/push-indicator/versions/1"):
        assert client.get(path).json() == {
            "name": "push-indicator",
            "versions": ["1", "2"],
            "platform": "onnx_onnxv1",
            "inputs": [
                {"name": "pusher", "datatype": "FP32", "shape": [-1, 3]},
                {"name": "context", "datatype": "FP32", "shape": [-1, 36]},
                {"name": "context_index", "datatype": "INT64", "shape": [-1]},
            ],
            "outputs": [
                {"name": "mean", "datatype": "FP32", "shape": [-1, 3]},
                {"name": "std", "datatype": "FP32", "shape": [-1, 3]},
            ],
        }
        assert client.get(f"{path}/ready").json() == {"name": "push-indicator", "ready": True}


def test_without_a_model_the_server_is_not_ready(tmp_path: Path) -> None:
    """Without a model, readiness is a 503 in the form of the protocol, and the process is alive."""
    models = LoadedModels(Registry(tmp_path / "nowhere"), load_fake)
    with TestClient(create_app(Settings(), models)) as client:
        error(client.get("/v2/health/ready"), 503)
        error(client.get("/v2/models/push-none/ready"), 503)
        assert client.get("/v2/health/live").status_code == 200


def test_unknown_models_and_routes_have_the_form_of_the_protocol(client: TestClient) -> None:
    """Unknown models, versions, routes and methods, and large bodies, are errors in the form of the protocol."""
    for path in (
        "/v2/models/nobody",
        "/v2/models/push-none/versions/9/ready",
        "/v2/nothing",
        "/v2/models/nobody/ready",
    ):
        error(client.get(path), 404)
    error(client.post("/v2/models/nobody/infer", json=document()), 404)
    error(client.get("/v2/models/push-none/versions/0/ready"))
    error(client.get("/v2/models/..%2Fetc/ready"), 404)
    error(client.get(URL), 405)
    error(client.post(URL, content=bytes((1 << 20) + 1)), 413)
