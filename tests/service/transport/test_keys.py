"""API keys: routes require one, changes of the file count soon, and a broken file changes no key."""

import os
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import pytest
from fastapi.routing import APIRoute
from fastapi.testclient import TestClient
from starlette.routing import BaseRoute, Route

from service.app import create_app
from service.errors import ForbiddenError, MissingKeyError, SettingsError
from service.inference.loaded_models import LoadedModels
from service.registry.registry import Registry
from service.settings import Settings
from service.transport.keys import Grant, KeyFile, Keys, Scope

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


def look(client: TestClient, times: int = 1) -> None:
    """Read the file of keys again, as the service does at intervals."""
    for _ in range(times):
        client.app.parts.keys.reread()  # type: ignore[attr-defined]


def test_a_key_gives_access_to_the_routes_of_its_scope(client: TestClient, path: Path) -> None:
    """A key with scope predict is accepted, and one with scope metrics is refused with 403."""
    key, other = grant(path, Scope.PREDICT), grant(path, Scope.METRICS)
    look(client)
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


def test_the_running_service_reads_the_file_again(client: TestClient, path: Path) -> None:
    """A background task of the application reads the file, so that keys are added and revoked without a restart."""
    first = grant(path, Scope.PREDICT)
    _wait_for(client, first, 200)
    path.write_text("")
    second = grant(path, Scope.PREDICT, Scope.METRICS, name="robot-8")
    _wait_for(client, first, 401)
    assert client.get("/v1/models", headers=bearer(second)).status_code == 200


def _wait_for(client: TestClient, key: str, status: int) -> None:
    for _ in range(200):
        if client.get("/v1/models", headers=bearer(key)).status_code == status:
            return
        time.sleep(0.05)
    pytest.fail(f"the key has no status {status}")


def accepted(keys: Keys, *candidates: str) -> list[bool]:
    """Return for each key whether it is accepted."""
    found = []
    for key in candidates:
        try:
            keys.admit(f"Bearer {key}".encode(), Scope.PREDICT)
        except MissingKeyError:
            found.append(False)
        else:
            found.append(True)
    return found


WRONG: Sequence[tuple[str, Callable[[Path], object]]] = [
    ("missing", lambda path: None),
    ("folder", Path.mkdir),
    ("pipe", os.mkfifo),
    ("device", lambda path: path.symlink_to("/dev/zero")),
    ("large", lambda path: path.write_text("#" * (2 << 20))),
    ("one line, not valid", lambda path: path.write_text("robot predict short")),
    ("UTF-16", lambda path: path.write_text("robot predict", "utf-16")),
    ("bytes", lambda path: path.write_bytes(bytes(range(256)))),
]


@pytest.mark.parametrize(("kind", "spoil"), WRONG, ids=[kind for kind, _ in WRONG])
def test_a_wrong_file_ends_the_start_and_later_keeps_the_last_keys(
    path: Path, kind: str, spoil: Callable[[Path], object], served: tuple[Registry, LoadedModels]
) -> None:
    """A file that is missing or wrong is an error at the start. Later the last keys stay, and problems say so."""
    key = grant(path, Scope.PREDICT)
    good = path.read_text()
    keys = Keys(path)
    path.unlink()
    spoil(path)
    for _ in range(3):
        keys.reread()
        assert accepted(keys, key) == [True], kind
        (problem,) = keys.problems
        assert problem.startswith("keys: ")
        assert problem.endswith("The keys of its last good state are accepted.")
        assert str(path.parent) not in problem
    with pytest.raises(SettingsError, match="CAZSL_KEYS"):
        create_app(Settings(keys=path), served[1])
    if path.is_dir():
        path.rmdir()
    path.unlink(missing_ok=True)
    path.write_text(good)
    keys.reread()
    assert (keys.problems, accepted(keys, key)) == ((), [True])


BAD_LINES = (
    *("robot predict short", f"robot admin {'0' * 64}", f"Robot 7 predict {'0' * 64}", f"robot predict {'A' * 64}"),
    *("\x00", "robot", f"robot\x0bpredict {'0' * 64}", f"röbot predict {'0' * 64}", f"robot predict, {'0' * 64}"),
)


@pytest.mark.parametrize("line", BAD_LINES)
def test_a_bad_line_costs_that_line_only(path: Path, line: str) -> None:
    """One line that is not valid is named by its number, and the keys of all other lines are accepted."""
    first = grant(path, Scope.PREDICT, name="first")
    with path.open("a", encoding="utf-8") as file:
        file.write(line + "\r\n")
    second = grant(path, Scope.PREDICT, name="second")
    keys = Keys(path)
    assert accepted(keys, first, second) == [True, True]
    (problem,) = keys.problems
    assert problem.startswith("keys: line 4: ")
    assert "robot" not in problem


def test_a_key_that_stands_twice_is_a_problem(path: Path) -> None:
    """The second line of one key is a problem, because its scopes would be in doubt."""
    key = grant(path, Scope.PREDICT)
    line = path.read_text().splitlines()[-1].replace("robot-7", "robot-8")
    path.write_text(f"{path.read_text()}{line}\n")
    keys = Keys(path)
    assert keys.problems == ("keys: line 4: the key of robot-7 again; remove one of the two lines",)
    assert accepted(keys, key) == [True]


def test_a_revoked_key_goes_at_the_second_reading(path: Path) -> None:
    """A key whose line is removed is refused from the second reading, although the file has the same size and time."""
    stays, goes = grant(path, Scope.PREDICT, name="stays"), grant(path, Scope.PREDICT, name="goes")
    keys, before = Keys(path), path.stat()
    lines = path.read_text().splitlines()
    path.write_text("\n".join([*lines[:-1], "#" * len(lines[-1])]) + "\n")
    os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns))
    assert path.stat().st_size == before.st_size
    keys.reread()
    assert accepted(keys, stays, goes) == [True, True]
    keys.reread()
    assert accepted(keys, stays, goes) == [True, False]


def test_a_file_that_is_being_written_anew_costs_no_key(path: Path) -> None:
    """An editor may empty a file before it writes it. A reading in between, whatever it sees, refuses no key."""
    key, other = grant(path, Scope.PREDICT), grant(path, Scope.PREDICT, name="robot-8")
    content, keys = path.read_bytes(), Keys(path)
    for length in range(0, len(content), 7):
        path.write_bytes(content[:length])
        keys.reread()
        assert accepted(keys, key, other) == [True, True]
        path.write_bytes(content)
        keys.reread()
        assert accepted(keys, key, other) == [True, True]


def test_a_revoked_key_does_not_return_with_a_fault(path: Path) -> None:
    """If the file is lost after a reading that lacked a key, the last good reading counts, without that key."""
    stays, goes = grant(path, Scope.PREDICT, name="stays"), grant(path, Scope.PREDICT, name="goes")
    keys = Keys(path)
    path.write_text("\n".join(path.read_text().splitlines()[:-1]))
    keys.reread()
    path.unlink()
    keys.reread()
    assert accepted(keys, stays, goes) == [True, False]


def test_a_file_that_stays_the_same_is_not_parsed_again(path: Path) -> None:
    """Ten thousand lines would hold the interpreter lock for 0.1 s, twice a second."""
    grant(path, Scope.PREDICT)
    first = KeyFile.read(path)
    path.touch()
    assert KeyFile.read(path, first) is first
    grant(path, Scope.PREDICT, name="robot-8")
    assert len(KeyFile.read(path, first).grants) == 2


def test_an_empty_file_revokes_every_key(path: Path) -> None:
    """A file without a key is a good reading, and a problem because every request is refused. It starts a service."""
    key = grant(path, Scope.PREDICT)
    keys = Keys(path)
    path.write_text("")
    keys.reread()
    keys.reread()
    assert accepted(keys, key) == [False]
    assert keys.problems == Keys(path).problems == ("keys: there is no key in the file, so every request is refused",)
    assert keys.count == 0


def test_a_scope_that_is_taken_away_goes_at_once(path: Path) -> None:
    """If a key stays and its scopes change, the new scopes count from the first reading."""
    key = grant(path, Scope.PREDICT)
    keys = Keys(path)
    path.write_text(path.read_text().replace("predict", "metrics"))
    keys.reread()
    with pytest.raises(ForbiddenError):
        keys.admit(f"Bearer {key}".encode(), Scope.PREDICT)


def test_a_byte_order_mark_is_skipped(path: Path) -> None:
    """A file of keys that an editor on Windows saved is read, with its mark and its line ends."""
    key = grant(path, Scope.PREDICT)
    path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes().splitlines()[-1] + b"\r\n")
    keys = Keys(path)
    assert (accepted(keys, key), keys.problems) == ([True], ())


def test_many_bad_lines_are_summed_up(path: Path) -> None:
    """Of many invalid lines the first ten are named, and the others are counted."""
    grant(path, Scope.PREDICT)
    path.write_text(path.read_text() + "x\n" * 1000)
    assert len(Keys(path).problems) == 11
    assert Keys(path).problems[-1] == "keys: 990 more lines are not valid"


def test_problems_of_the_file_are_shown(client: TestClient, path: Path) -> None:
    """A problem is in /readyz, in the metrics and in the log, and does not make the service unready."""
    key = grant(path, Scope.METRICS)
    look(client)
    assert client.get("/readyz").json()["problems"] == []
    path.unlink()
    look(client)
    ready = client.get("/readyz")
    assert ready.status_code == 200
    assert ready.json()["problems"][0].startswith("keys: the file of keys cannot be read")
    text = client.get("/metrics", headers=bearer(key)).text
    assert "cazsl_keys_problems 1.0" in text
    assert "cazsl_keys 1.0" in text


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
    assert KeyFile.parse(made.line().encode()) == KeyFile({made.sha256: made}, (), made.line().encode())
    assert key not in made.line()
    assert Grant.new("robot-7", frozenset(Scope))[1] != key
