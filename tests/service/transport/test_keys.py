"""API keys: routes require one, changes of the file count at once, and a broken file accepts no key."""

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
    """Add a key to a file, and return the key."""
    made, key = Grant.new(name, frozenset(scopes))
    with path.open("a") as file:
        file.write(made.line() + "\n")
    return key


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """Return a file of keys that has none."""
    found = tmp_path / "keys"
    found.write_text("# keys\n\n")
    return found


@pytest.fixture
def client(served: tuple[Registry, LoadedModels], path: Path) -> Iterator[TestClient]:
    """Return a client of the application with keys."""
    with TestClient(create_app(Settings(keys=path, poll_interval_s=3600), served[1])) as found:
        yield found


def bearer(key: str) -> dict[str, str]:
    """Return the header with a key."""
    return {"Authorization": f"Bearer {key}"}


def routes_of(routes: list[BaseRoute]) -> Iterator[Route]:
    """Yield every route, also those of included routers."""
    for route in routes:
        if isinstance(route, Route):
            yield route
        else:
            inner = getattr(route, "effective_route_contexts", None) or getattr(route, "routes", [])
            yield from routes_of(list(inner() if callable(inner) else inner))


def test_every_route_but_health_and_documentation_requires_a_key(client: TestClient) -> None:
    """Every documented route requires a key, unless this module lists it as open."""
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


def test_every_route_is_in_the_document(client: TestClient) -> None:
    """The document has every route but the open ones, so the test above sees each of them."""
    app = client.app
    paths = set(client.get("/openapi.json").json()["paths"])
    hidden = {route.path for route in routes_of(app.routes) if not isinstance(route, APIRoute)}  # type: ignore[attr-defined]
    assert hidden <= OPEN
    assert "/v1/predict" in paths


def test_a_key_gives_access_to_the_routes_of_its_scope(client: TestClient, path: Path) -> None:
    """A key with scope predict is accepted, and one with scope metrics is refused with 403."""
    key, other = grant(path, Scope.PREDICT), grant(path, Scope.METRICS)
    assert client.post("/v1/predict", json=PUSH, headers=bearer(key)).status_code == 200
    assert client.get("/v1/models", headers=bearer(key)).status_code == 200
    assert client.get("/v2", headers=bearer(key)).status_code == 200
    refused = client.post("/v1/predict", json=PUSH, headers=bearer(other))
    assert (refused.status_code, refused.json()["code"]) == (403, "forbidden")


def test_an_unknown_key_is_refused_and_not_repeated(client: TestClient, path: Path) -> None:
    """An unknown key, a truncated one, or one under another scheme is refused, and the answer does not repeat it."""
    key = grant(path, Scope.PREDICT)
    for header in ("Bearer nonsense-key", f"Basic {key}", key, f"Bearer {key[:-1]}", "Bearer", ""):
        response = client.post("/v1/predict", json=PUSH, headers={"Authorization": header})
        assert (response.status_code, response.json()["code"]) == (401, "missing_key")
        assert "nonsense" not in response.text


def test_the_file_is_read_again_when_it_changes(client: TestClient, path: Path) -> None:
    """Keys are added and revoked without a restart."""
    first = grant(path, Scope.PREDICT)
    assert client.get("/v1/models", headers=bearer(first)).status_code == 200
    path.write_text("")
    second = grant(path, Scope.PREDICT, Scope.METRICS, name="robot-8")
    assert client.get("/v1/models", headers=bearer(first)).status_code == 401
    assert client.get("/v1/models", headers=bearer(second)).status_code == 200


@pytest.mark.parametrize("content", ["robot predict short", "robot admin " + "0" * 64, "\x00", "a" * (2 << 20)])
def test_a_broken_file_accepts_no_key(path: Path, content: str) -> None:
    """If one line is broken, the keys of other lines are refused too, until the file is repaired."""
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


def test_a_missing_file_accepts_no_key(path: Path) -> None:
    """If the file is missing, every key is refused, until the file is back."""
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


def test_admission_returns_the_grant_of_the_key(path: Path) -> None:
    """An admitted request has the grant of its key, so that limits can count by caller. Without keys it has none."""
    key = grant(path, Scope.PREDICT, name="robot-9")
    admitted = Keys(path).admit(f"Bearer {key}".encode(), Scope.PREDICT)
    assert admitted is not None
    assert admitted.name == "robot-9"
    assert Keys(None).admit(None, Scope.PREDICT) is None


def test_a_grant_is_its_line_and_never_its_key() -> None:
    """A grant is parsed from its own line, which does not contain the key."""
    made, key = Grant.new("robot-7", frozenset(Scope))
    assert parse(made.line()) == (made,)
    assert key not in made.line()
    assert Grant.new("robot-7", frozenset())[1] != key
