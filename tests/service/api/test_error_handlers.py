"""Failures of the framework are answered as problems."""

from fastapi.testclient import TestClient

from tests.service.api.v1.requests import problem


def test_unknown_routes_and_methods_are_problems(client: TestClient) -> None:
    """404 and 405 have the form of every problem, and 405 lists the allowed methods."""
    problem(client.get("/v1/nothing"), 404, "no_such_route")
    problem(client.get("/v1/models/", follow_redirects=False), 404, "no_such_route")
    response = client.get("/v1/predict")
    problem(response, 405, "method_not_allowed")
    assert response.headers["allow"] == "POST"


def test_a_parameter_that_is_not_valid_is_a_problem(client: TestClient) -> None:
    """The framework checks parameters of a path, and the problem names the field."""
    found = problem(client.get("/v1/models/push-none/versions/0"), 422, "invalid_request")
    assert found["errors"][0]["where"] == "path.version"
