"""Routes of health and metrics, over the whole application."""

from pathlib import Path

import pytest
from fastapi.testclient import TestClient
from prometheus_client.parser import text_string_to_metric_families

from service.app import create_app
from service.inference.loaded_models import LoadedModels
from service.registry.registry import Registry
from service.settings import Settings
from service.transport.keys import Grant, Scope
from tests.fakes import load_fake, publish_fake
from tests.service.api.v1.requests import CONTEXT, PUSHER, predict, problem

BODY = {"pusher": PUSHER, "context": CONTEXT}


def lines(client: TestClient, **headers: str) -> list[str]:
    """Return the lines of a scrape."""
    response = client.get("/metrics", headers=headers)
    assert response.status_code == 200, response.text
    assert response.headers["content-type"] == "text/plain; version=0.0.4; charset=utf-8"
    assert list(text_string_to_metric_families(response.text))
    return response.text.splitlines()


@pytest.mark.parametrize(
    "content_type", ["application/json", "application/json; charset=utf-8"], ids=["usual type", "unusual type"]
)
def test_a_prediction_is_in_the_metrics(client: TestClient, content_type: str) -> None:
    """A prediction is counted by route, model and version, with its inference, for any content type."""
    for _ in range(3):
        client.post("/v1/predict", json=BODY, headers={"Content-Type": content_type})
    labels = '{model="push-indicator",route="/v1/predict",version="1"}'
    found = lines(client)
    assert f"cazsl_request_duration_seconds_count{labels} 3.0" in found
    assert f"cazsl_inference_duration_seconds_count{labels} 3.0" in found
    assert f"cazsl_request_rows_sum{labels} 3.0" in found


def test_texts_of_callers_make_no_series(client: TestClient) -> None:
    """Labels of metrics have no path and no name of a model from the network."""
    for number in range(50):
        client.post("/v1/predict", json=BODY | {"model": f"made-up-{number}"})
        client.get(f"/made-up-{number}")
        client.get(f"/v2/models/made-up-{number}")
    found = lines(client)
    assert not [line for line in found if "made-up" in line]
    assert 'cazsl_refusals_total{reason="unknown_model"} 100.0' in found
    assert 'cazsl_requests_total{route="unknown",status="404"} 50.0' in found


def test_models_and_their_changes_are_in_the_metrics(client: TestClient) -> None:
    """The metrics have the loaded versions, their aliases and the state of the registry."""
    found = lines(client)
    for line in (
        'cazsl_model_ready{model="push-indicator",version="1"} 1.0',
        'cazsl_alias_version{alias="champion",model="push-indicator"} 1.0',
        'cazsl_model_loads_total{model="push-indicator"} 1.0',
        "cazsl_ready 1.0",
        "cazsl_registry_up 1.0",
        "cazsl_requests_in_flight 0.0",
    ):
        assert line in found


def test_metrics_require_a_key_with_their_own_scope(served: tuple[Registry, LoadedModels], tmp_path: Path) -> None:
    """A key for predictions cannot read metrics, and a key for metrics can."""
    robot, robot_key = Grant.new("robot", frozenset({Scope.PREDICT}))
    prometheus, prometheus_key = Grant.new("prometheus", frozenset({Scope.METRICS}))
    (tmp_path / "keys").write_text(f"{robot.line()}\n{prometheus.line()}\n")
    app = create_app(Settings(poll_interval_s=3600, keys=tmp_path / "keys"), served[1])
    with TestClient(app, raise_server_exceptions=False) as client:
        assert client.get("/metrics").status_code == 401
        assert client.get("/metrics", headers={"Authorization": f"Bearer {robot_key}"}).status_code == 403
        assert lines(client, Authorization=f"Bearer {prometheus_key}")


def test_metrics_on_a_separate_port_are_not_on_the_main_port(served: tuple[Registry, LoadedModels]) -> None:
    """With a separate port for metrics, the port of the service does not have them."""
    with TestClient(create_app(Settings(poll_interval_s=3600, metrics_port=9100), served[1])) as client:
        assert client.get("/metrics").status_code == 404


def test_without_a_model_predictions_are_not_ready(tmp_path: Path) -> None:
    """Without a model, predictions and readiness are a 503 with a pause, and the process is alive."""
    models = LoadedModels(Registry(tmp_path / "nowhere"), load_fake)
    with TestClient(create_app(Settings(), models)) as client:
        response = predict(client, {"pusher": PUSHER, "context": CONTEXT})
        problem(response, 503, "model_not_ready")
        assert response.headers["retry-after"] == "1"
        ready = client.get("/readyz")
        assert (ready.status_code, ready.json()["ready"]) == (503, False)
        assert "cannot be listed" in ready.json()["problems"][0]
        assert client.get("/livez").json() == {"live": True}


def test_readiness_lists_a_broken_version_and_stays_ready(
    client: TestClient, served: tuple[Registry, LoadedModels]
) -> None:
    """A broken version is listed with its reason, and the loaded version stays served."""
    registry, models = served
    publish_fake(registry, model=b"broken")
    models.refresh()
    ready = client.get("/readyz")
    assert ready.status_code == 200
    assert ready.json()["models"] == {"push-indicator": [1], "push-none": [1]}
    assert any("push-indicator@2 is broken" in text for text in ready.json()["problems"])
    assert predict(client, {"pusher": PUSHER, "context": CONTEXT}).json()["model"]["version"] == 1
