"""The application composes all parts, and polls the registry for as long as it lives."""

import asyncio
import io
import logging
import re
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from fastapi.testclient import TestClient

from service.app import Service, create_app
from service.inference.loaded_models import LoadedModels
from service.inference.readiness import Readiness
from service.observability.logs import RequestLog
from service.registry.registry import Registry
from service.settings import Settings
from service.transport.keys import Grant, Keys, Scope
from tests.fakes import Panic, fake_models, load_fake, publish_fake


@pytest.fixture
def models(tmp_path: Path) -> LoadedModels:
    """Return loaded fake models."""
    return fake_models(tmp_path / "models")[1]


def test_with_a_ring_around_all_requests_there_is_no_shortcut(models: LoadedModels) -> None:
    """A ring for spans must see every request, so the application has no shortcut."""

    def ring(app: Any) -> Any:
        """Wrap an application."""
        return lambda *asgi: app(*asgi)

    assert create_app(Settings(), models, trace=ring).shortcut is None
    assert create_app(Settings(), models).shortcut is not None


class Work:
    """Work of a background task that does nothing, or has the fault that a test sets."""

    def __init__(self) -> None:
        self.error: BaseException | None = None
        self.hanging = False
        self.released = threading.Event()

    def do(self) -> None:
        """Raise the error, hang, or return."""
        if self.error is not None:
            raise self.error
        if self.hanging:
            self.released.wait()


class FaultyModels(LoadedModels):
    """Loaded models whose polls have a fault."""

    work: Work

    def refresh(self) -> None:
        """See ``LoadedModels``."""
        self.work.do()
        super().refresh()


class FaultyStream(io.StringIO):
    """A stream of the log that has a fault."""

    work: Work

    def write(self, text: str) -> int:
        """See ``TextIO``."""
        self.work.do()
        return super().write(text)


TASKS = ("poll", "probe", "keys", "log")
each_task = pytest.mark.parametrize("task", TASKS)


@pytest.fixture
def works() -> dict[str, Work]:
    """Return the work of each background task."""
    return {task: Work() for task in TASKS}


@pytest.fixture
def faulty(
    tmp_path: Path, works: dict[str, Work], monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> Iterator[tuple[Service, TestClient]]:
    """Return an application whose background tasks do the works of the test, and a client."""
    caplog.set_level(logging.INFO)  # so that requests leave lines
    registry = Registry(tmp_path / "models")
    publish_fake(registry)
    models, stream = FaultyModels(registry, load_fake), FaultyStream()
    models.work, stream.work = works["poll"], works["log"]

    async def probe(_: Readiness) -> None:
        """Do the work of the probes, which Readiness itself keeps from the faults of models."""
        if works["probe"].hanging:
            await asyncio.Event().wait()
        works["probe"].do()

    monkeypatch.setattr(Readiness, "probe", probe)
    grant, key = Grant.new("test", frozenset(Scope))
    (tmp_path / "keys").write_text(f"{grant.line()}\n")
    monkeypatch.setattr(Keys, "reread", lambda _: works["keys"].do())
    monkeypatch.setattr("service.app.READ_INTERVAL_S", 0.02)
    settings = Settings(poll_interval_s=0.02, probe_interval_s=0.02, keys=tmp_path / "keys")
    app = create_app(settings, models, RequestLog(stream))
    with TestClient(app, headers={"Authorization": f"Bearer {key}"}) as client:
        yield app, client
        for work in works.values():
            work.released.set()


def tasks(client: TestClient) -> dict[str, dict[str, Any]]:
    """Return the background tasks that /readyz shows, by name."""
    return {task["name"]: task for task in client.get("/readyz").json()["tasks"]}


def metric(client: TestClient, name: str, task: str) -> float:
    """Return a metric of a task."""
    (line,) = re.findall(rf'^{name}{{task="{task}"}} (.*)$', client.get("/metrics").text, re.MULTILINE)
    return float(line)


def ask(client: TestClient) -> None:
    """Send a push, which is answered, and leaves a line of the log."""
    body = {"pusher": {"x": 0.0, "y": 0.0, "angle": 0.0}, "context": {"descriptor": "1a2b3c4a"}}
    assert client.post("/v1/predict", json=body).status_code == 200


def test_every_background_task_is_supervised(faulty: tuple[Service, TestClient], project_root: Path) -> None:
    """The tasks below are all tasks of the application. No other module starts a task or a thread."""
    assert tuple(tasks(faulty[1])) == TASKS
    documented = (project_root / "docs" / "operations.md").read_text(encoding="utf-8").partition("| task | work |")[2]
    assert re.findall(r"^\| `(\w+)` \|", documented.partition("\n\n")[0], re.MULTILINE) == list(TASKS)
    starters = re.compile(
        r"\b(to_thread|run_in_executor|create_task|ensure_future|TaskGroup|ThreadPoolExecutor|Thread|Timer"
        r"|start_http_server|run_in_threadpool|run_sync)\("
    )
    found = {
        path.relative_to(project_root / "service").as_posix(): set(starters.findall(path.read_text(encoding="utf-8")))
        for path in sorted((project_root / "service").rglob("*.py"))
        if path.parent.name != "client"
    }
    assert {name: names for name, names in found.items() if names} == {
        "background/ending.py": {"Thread"},  # ends the process
        "background/supervision.py": {"create_task"},
        "background/threads.py": {"Thread"},
        "bulk/executors.py": {"ThreadPoolExecutor", "Thread"},  # of the command line
        "model/trial.py": {"Thread", "Timer"},  # end a process and collect its exit status
        "observability/log_writer.py": {"Thread"},  # the task log
        "transport/fast_path.py": {"ensure_future"},  # an answer and the end of its client: both end with the request
        "transport/threads.py": {"ThreadPoolExecutor"},  # the work of requests
    }


@each_task
@pytest.mark.parametrize("error", [ZeroDivisionError("a bug"), Panic("a panic")], ids=repr)
def test_every_task_goes_on_after_any_error(
    faulty: tuple[Service, TestClient], works: dict[str, Work], task: str, error: BaseException
) -> None:
    """Failures are counted and named, requests and other tasks go on, and the task recovers."""
    client = faulty[1]
    works[task].error = error
    while (found := tasks(client))[task]["failures"] < 3:
        ask(client)
    assert found[task]["error"] == type(error).__name__
    assert metric(client, "cazsl_task_failures_total", task) >= 3.0
    for other in set(TASKS) - {task}:
        assert found[other]["failures"] == 0
    works[task].error = None
    while tasks(client)[task]["error"] is not None:
        ask(client)


@each_task
def test_a_task_that_hangs_is_seen_and_stops_no_other(
    faulty: tuple[Service, TestClient], works: dict[str, Work], task: str
) -> None:
    """The age of a task that hangs grows until it is late. Requests and other tasks go on, and so does the end."""
    app, client = faulty
    health = {health.name: health for health in app.parts.supervisor.health()}
    works[task].hanging = True
    health[task].limit_s = 0.3
    while not tasks(client)[task]["late"]:
        ask(client)
    assert metric(client, "cazsl_task_late", task) == 1.0
    assert metric(client, "cazsl_task_age_seconds", task) > 0.3
    for other in set(TASKS) - {task}:
        assert not health[other].is_late()
        assert health[other].age_s() < health[task].age_s()
