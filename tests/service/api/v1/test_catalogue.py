"""The catalogue lists the served models with versions and aliases."""

from pathlib import Path

import pytest
from fastapi.testclient import TestClient

from service.api.v1.catalogue import model_body, version_body
from service.inference.loaded_models import LoadedModels
from service.inference.snapshot import DEFAULT_MODELS
from service.model.predictor import OnnxPredictor
from service.registry.registry import Registry
from service.validity.domains import RING


def test_models_are_listed_with_versions_and_aliases(client: TestClient) -> None:
    """The list, one model and one version agree, and the version has its manifest and its card."""
    catalogue = client.get("/v1/models").json()
    assert catalogue["defaults"] == DEFAULT_MODELS
    listed = catalogue["models"]
    assert [model["name"] for model in listed] == ["push-indicator", "push-none"]
    assert client.get("/v1/models/push-indicator").json() == listed[0]
    assert listed[0] == {
        "name": "push-indicator",
        "method": "FCN + CM",
        "context_kind": "indicator",
        "versions": [1],
        "aliases": {"champion": 1},
        "vouches_for": {},
    }
    version = client.get("/v1/models/push-indicator/versions/1").json()
    assert version["aliases"] == ["champion"]
    assert version["manifest"]["data"]["source"] == "fake pushes"
    assert version["card"] == "# push-indicator\n"
    assert version["validity"] is None


def test_every_version_that_ships_says_which_pushes_it_vouches_for(project_root: Path) -> None:
    """A version that learnt a ring of starts says so, although its files were published before there were domains."""
    models = LoadedModels(Registry(project_root / "models"), OnnxPredictor)
    models.refresh()
    body = model_body(models.snapshot, "push-indicator")
    assert list(body.vouches_for) == body.versions
    assert body.vouches_for[2] == RING.note
    assert "between touch and 124 mm" in body.vouches_for[3]
    for version, (low_m, high_m) in ((2, RING.ranges["start_distance_m"]), (3, (0.047, 0.123))):
        found = version_body(models.snapshot, "push-indicator", version)
        assert found.validity is not None
        assert found.validity.note == body.vouches_for[version]
        assert found.validity.ranges["start_distance_m"] == pytest.approx((low_m, high_m), abs=1e-3)


@pytest.mark.parametrize(
    ("path", "status"),
    [("/v1/models/none", 404), ("/v1/models/push-none/versions/9", 404), ("/v1/models/push-none/versions/x", 422)],
)
def test_a_model_that_is_not_served_is_a_problem(client: TestClient, path: str, status: int) -> None:
    """Unknown names and versions are a 404, and a version that is not a number is a 422."""
    response = client.get(path)
    assert response.status_code == status
    assert response.headers["content-type"] == "application/problem+json"
