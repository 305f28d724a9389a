"""The catalogue lists the served models with versions and aliases."""

import pytest
from fastapi.testclient import TestClient

from service.inference.snapshot import DEFAULT_MODELS


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
    }
    version = client.get("/v1/models/push-indicator/versions/1").json()
    assert version["aliases"] == ["champion"]
    assert version["manifest"]["data"]["source"] == "fake pushes"
    assert version["card"] == "# push-indicator\n"


@pytest.mark.parametrize(
    ("path", "status"),
    [("/v1/models/none", 404), ("/v1/models/push-none/versions/9", 404), ("/v1/models/push-none/versions/x", 422)],
)
def test_a_model_that_is_not_served_is_a_problem(client: TestClient, path: str, status: int) -> None:
    """Unknown names and versions are a 404, and a version that is not a number is a 422."""
    response = client.get(path)
    assert response.status_code == status
    assert response.headers["content-type"] == "application/problem+json"
