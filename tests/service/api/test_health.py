"""``/metrics`` over the whole app."""

from pathlib import Path

import pytest
from fastapi.testclient import TestClient
from prometheus_client.parser import text_string_to_metric_families

from service.app import create_app
from service.inference.loaded_models import LoadedModels
from service.registry.registry import Registry
from service.settings import Settings
from service.transport.keys import Grant, Scope

BODY = {"pusher": {"x": -0.075, "y": 0.0, "angle": 0.0}, "context": {"descriptor": "1a2b3c4a"}}


def lines(client: TestClient, **headers: str) -> list[str]:
    """The lines of a scrape."""
    response = client.get("/metrics", headers=headers)
    assert response.status_code == 200, response.text
    assert response.headers["content-type"] == "text/plain; version=0.0.4; charset=utf-8"
    assert list(text_string_to_metric_families(response.text))
    return response.text.splitlines()


@pytest.mark.parametrize("content_type", ["application/json", "application/json; charset=utf-8"], ids=["fast", "slow"])
def test_a_prediction_shows_whichever_way_it_went(client: TestClient, content_type: str) -> None:
    """Its route, model, version and inference."""
    for _ in range(3):
        client.post("/v1/predict", json=BODY, headers={"Content-Type": content_type})
    labels = '{model="push-indicator",route="/v1/predict",version="1"}'
    found = lines(client)
    assert f"cazsl_request_duration_seconds_count{labels} 3.0" in found
    assert f"cazsl_inference_duration_seconds_count{labels} 3.0" in found
    assert f"cazsl_request_rows_sum{labels} 3.0" in found


def test_what_callers_write_makes_no_series(client: TestClient) -> None:
    """Paths and names of models come from the network: the labels do not."""
    for number in range(50):
        client.post("/v1/predict", json=BODY | {"model": f"made-up-{number}"})
        client.get(f"/made-up-{number}")
        client.get(f"/v2/models/made-up-{number}")
    found = lines(client)
    assert not [line for line in found if "made-up" in line]
    assert 'cazsl_refusals_total{reason="unknown_model"} 100.0' in found
    assert 'cazsl_requests_total{route="unknown",status="404"} 50.0' in found


def test_models_and_their_changes_are_there(client: TestClient) -> None:
    """What is loaded, what the aliases mean, and whether the registry was seen."""
    found = lines(client)
    for line in (
        'cazsl_model_ready{model="push-indicator",version="1"} 1.0',
        'cazsl_alias_version{alias="champion",model="push-indicator"} 1.0',
        'cazsl_model_loads_total{model="push-indicator"} 1.0',
        "cazsl_ready 1.0",
        "cazsl_registry_up 1.0",
        "cazsl_requests_in_flight 1.0",
    ):
        assert line in found


def test_with_keys_metrics_want_their_own_scope(served: tuple[Registry, LoadedModels], tmp_path: Path) -> None:
    """A robot's key predicts and does not look; Prometheus's key looks."""
    robot, robot_key = Grant.new("robot", frozenset({Scope.PREDICT}))
    prometheus, prometheus_key = Grant.new("prometheus", frozenset({Scope.METRICS}))
    (tmp_path / "keys").write_text(f"{robot.line()}\n{prometheus.line()}\n")
    app = create_app(Settings(poll_interval_s=3600, keys=tmp_path / "keys"), served[1])
    with TestClient(app, raise_server_exceptions=False) as client:
        assert client.get("/metrics").status_code == 401
        assert client.get("/metrics", headers={"Authorization": f"Bearer {robot_key}"}).status_code == 403
        assert lines(client, Authorization=f"Bearer {prometheus_key}")


def test_on_a_port_of_their_own_they_are_not_on_the_services(served: tuple[Registry, LoadedModels]) -> None:
    """What is behind one door is not behind two."""
    with TestClient(create_app(Settings(poll_interval_s=3600, metrics_port=9100), served[1])) as client:
        assert client.get("/metrics").status_code == 404
