"""Routes of the framework answer with the endpoint of their template."""

import pytest
from fastapi.testclient import TestClient

from tests.service.api.v1.requests import JSON


@pytest.mark.parametrize("path", ["/v1/predict%0A", "/v2/models/push-none/infer%0A"])
def test_a_path_with_a_newline_at_its_end_is_answered(client: TestClient, path: str) -> None:
    """The framework matches such a path to a route, which answers with the endpoint of its template."""
    assert client.post(path, content=b"{", headers=JSON).status_code == 400
