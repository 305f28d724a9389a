"""API keys: every route wants one, the file decides at once, and what is broken opens nothing."""

import os
from collections.abc import Iterator
from pathlib import Path

import pytest
from fastapi.routing import APIRoute
from fastapi.testclient import TestClient
from starlette.routing import BaseRoute, Route

from service.app import create_app
from service.errors import ForbiddenError, MissingKeyError
from service.inference.loaded_models import LoadedModels
from service.registry.registry import Registry
from service.settings import Settings
from service.transport.keys import Grant, Keys, Scope, parse

OPEN = {"/livez", "/readyz", "/v2/health/live", "/v2/health/ready", "/docs", "/docs/{part}", "/openapi.json"}
PUSH = {"pusher": {"x": -0.075, "y": 0.0, "angle": 0.0}}


def grant(path: Path, *scopes: Scope, name: str = "robot-7") -> str:
    """Add a key to a file; the key."""
    made, key = Grant.new(name, frozenset(scopes))
    with path.open("a") as file:
        file.write(made.line() + "\n")
    return key


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """An empty file of keys."""
    found = tmp_path / "keys"
    found.write_text("# keys\n\n")
    return found


@pytest.fixture
def client(served: tuple[Registry, LoadedModels], path: Path) -> Iterator[TestClient]:
    """The app with keys."""
    with TestClient(create_app(Settings(keys=path, poll_interval_s=3600), served[1])) as found:
        yield found


def bearer(key: str) -> dict[str, str]:
    """The header."""
    return {"Authorization": f"Bearer {key}"}


def routes_of(routes: list[BaseRoute]) -> Iterator[Route]:
    """Every route, those of included routers too."""
    for route in routes:
        if isinstance(route, Route):
            yield route
        else:
            inner = getattr(route, "effective_route_contexts", None) or getattr(route, "routes", [])
            yield from routes_of(list(inner() if callable(inner) else inner))


def test_every_route_but_health_and_documentation_wants_a_key(client: TestClient) -> None:
    """A new route is closed unless it is named here."""
    document = client.get("/openapi.json").json()
    walked = 0
    for template, operations in document["paths"].items():
        path = template.replace("{name}", "push-none").replace("{version}", "1")
        for method in operations:
            response = client.request(method, path)
            walked += 1
            if template in OPEN:
                assert response.status_code == 200, (method, path)
            else:
                assert response.status_code == 401, (method, path)
                assert response.headers["www-authenticate"] == "Bearer"
    assert walked > 12


def test_every_route_is_in_the_document_that_was_walked(client: TestClient) -> None:
    """Nothing is served that the walk above does not see."""
    app = client.app
    paths = set(client.get("/openapi.json").json()["paths"])
    hidden = {route.path for route in routes_of(app.routes) if not isinstance(route, APIRoute)}  # type: ignore[attr-defined]
    assert hidden <= OPEN
    assert "/v1/predict" in paths


def test_a_key_opens_what_its_scope_covers(client: TestClient, path: Path) -> None:
    """Predict does; a key for metrics alone is known and refused."""
    key, other = grant(path, Scope.PREDICT), grant(path, Scope.METRICS)
    assert client.post("/v1/predict", json=PUSH, headers=bearer(key)).status_code == 200
    assert client.get("/v1/models", headers=bearer(key)).status_code == 200
    assert client.get("/v2", headers=bearer(key)).status_code == 200
    refused = client.post("/v1/predict", json=PUSH, headers=bearer(other))
    assert (refused.status_code, refused.json()["code"]) == (403, "forbidden")


def test_an_unknown_key_is_refused_and_not_repeated(client: TestClient, path: Path) -> None:
    """Nor is a known one under another word, or cut short."""
    key = grant(path, Scope.PREDICT)
    for header in ("Bearer nonsense-key", f"Basic {key}", key, f"Bearer {key[:-1]}", "Bearer", ""):
        response = client.post("/v1/predict", json=PUSH, headers={"Authorization": header})
        assert (response.status_code, response.json()["code"]) == (401, "missing_key")
        assert "nonsense" not in response.text


def test_the_file_is_read_again_when_it_changes(client: TestClient, path: Path) -> None:
    """A key is admitted and refused without a restart."""
    first = grant(path, Scope.PREDICT)
    assert client.get("/v1/models", headers=bearer(first)).status_code == 200
    path.write_text("")
    second = grant(path, Scope.PREDICT, Scope.METRICS, name="robot-8")
    assert client.get("/v1/models", headers=bearer(first)).status_code == 401
    assert client.get("/v1/models", headers=bearer(second)).status_code == 200


@pytest.mark.parametrize("content", ["robot predict short", "robot admin " + "0" * 64, "\x00", "a" * (2 << 20)])
def test_a_file_that_is_broken_opens_nothing(path: Path, content: str) -> None:
    """Not even what its other lines say; and mending it is enough."""
    key = grant(path, Scope.PREDICT)
    good = path.read_text()
    keys = Keys(path)
    keys.admit(f"Bearer {key}".encode(), Scope.PREDICT)
    path.write_text(good + content)
    with pytest.raises(MissingKeyError):
        keys.admit(f"Bearer {key}".encode(), Scope.PREDICT)
    path.write_text(good)
    os.utime(path, ns=(0, 0))
    keys.admit(f"Bearer {key}".encode(), Scope.PREDICT)


def test_a_file_that_is_gone_opens_nothing(path: Path) -> None:
    """And it is back when it is back."""
    key = f"Bearer {grant(path, Scope.PREDICT)}".encode()
    keys = Keys(path)
    keys.admit(key, Scope.PREDICT)
    away = path.rename(path.with_name("away"))
    with pytest.raises(MissingKeyError):
        keys.admit(key, Scope.PREDICT)
    away.rename(path)
    keys.admit(key, Scope.PREDICT)
    with pytest.raises(ForbiddenError):
        keys.admit(key, Scope.METRICS)


def test_a_grant_is_its_line_and_never_its_key() -> None:
    """What is written is read as the same, and the key is in none of it."""
    made, key = Grant.new("robot-7", frozenset(Scope))
    assert parse(made.line()) == (made,)
    assert key not in made.line()
    assert Grant.new("robot-7", frozenset())[1] != key
