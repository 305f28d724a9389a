"""Routes get the parts of the application, and require keys."""

from pathlib import Path

import pytest
from fastapi.testclient import TestClient

from service.app import create_app
from service.inference.loaded_models import LoadedModels
from service.registry.registry import Registry
from service.settings import Settings
from service.transport.keys import Grant, Scope


@pytest.mark.parametrize(("scope", "status"), [(Scope.PREDICT, 200), (Scope.METRICS, 403)])
def test_a_route_requires_the_scope_of_predictions(
    served: tuple[Registry, LoadedModels], tmp_path: Path, scope: Scope, status: int
) -> None:
    """A key with the scope of predictions reads the catalogue, and another key does not."""
    grant, key = Grant.new("robot", frozenset({scope}))
    (tmp_path / "keys").write_text(grant.line())
    with TestClient(create_app(Settings(keys=tmp_path / "keys", poll_interval_s=3600), served[1])) as client:
        assert client.get("/v1/models").status_code == 401
        assert client.get("/v1/models", headers={"Authorization": f"Bearer {key}"}).status_code == status


def test_a_route_sees_the_models_of_the_last_poll(client: TestClient, served: tuple[Registry, LoadedModels]) -> None:
    """A route reads the snapshot and the readiness of the application that answers."""
    registry, models = served
    assert len(client.get("/v1/models").json()["models"]) == 2
    registry.drop_alias("push-none", "champion")
    registry.remove("push-none", 1)
    models.refresh()
    assert len(client.get("/v1/models").json()["models"]) == 1
    assert [check["name"] for check in client.get("/readyz").json()["checks"]] == ["push-indicator"]
