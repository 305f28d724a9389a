"""Every 500, on every route and by every way to it, leaves its cause in the log under the id of its request."""

import asyncio
import io
import json
import logging
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import pytest
from fastapi.testclient import TestClient
from httpx2 import Response
from opentelemetry.sdk.trace import TracerProvider
from starlette.exceptions import HTTPException
from starlette.types import ASGIApp

from service.api.error_handlers import install_error_handlers
from service.app import Service, create_app
from service.errors import PredictionError
from service.inference.loaded_models import LoadedModels
from service.inference.snapshot import Snapshot
from service.model.tensors import FloatArray, Gaussians, IndexArray, Tensor
from service.observability.logs import RequestLog
from service.observability.telemetry import RequestTelemetry
from service.observability.tracing import Tracing
from service.registry.registry import Registry
from service.settings import Settings
from service.transport.admission import Admission, AdmissionLimits
from service.transport.callers import Callers
from service.transport.keys import Keys
from service.transport.problems import problem_response
from tests.fake_connection import FakeConnection
from tests.fakes import FakePredictor, Panic, all_fake_models, is_checked

ID = "an-id-of-the-caller"
CAUSE = "the cause that only the log may have"
WITHOUT_MODELS = {"/livez", "/docs", "/docs/{part}", "/openapi.json", "/v2", "/v2/health/live"}
PUSH = {"pusher": {"x": -0.075, "y": 0.0, "angle": 0.0}, "context": {"descriptor": "1a2b3c4a"}}


def prediction_error() -> PredictionError:
    """Return an error of our tree whose cause is in a library."""
    error = PredictionError("the runtime could not evaluate the model")
    error.__cause__ = RuntimeError(CAUSE)
    return error


ERRORS = [ZeroDivisionError(CAUSE), Panic(CAUSE), StopIteration(CAUSE), prediction_error()]
each_error = pytest.mark.parametrize("error", ERRORS, ids=lambda error: type(error).__name__)


class FailingPredictor(FakePredictor):
    """A predictor that raises the error of its models for every push but self-checks."""

    models: "FailingModels"

    def predict(
        self, pusher: FloatArray, contexts: tuple[FloatArray, ...], context_index: IndexArray | None
    ) -> Gaussians:
        """See ``FakePredictor``."""
        if self.models.prediction is not None and not is_checked(pusher):
            raise self.models.prediction
        return super().predict(pusher, contexts, context_index)


class FailingModels(LoadedModels):
    """Loaded models that fail when they are asked for, or when they predict."""

    error: BaseException | None = None
    prediction: BaseException | None = None

    def __init__(self, registry: Registry) -> None:
        def load(model: bytes, inputs: Sequence[Tensor], outputs: Sequence[Tensor]) -> FailingPredictor:
            """Create a predictor of these models."""
            predictor = FailingPredictor(model, len(inputs) > 1)
            predictor.models = self
            return predictor

        super().__init__(registry, load)

    @property
    def snapshot(self) -> Snapshot:
        """Return the snapshot, or raise the error."""
        if self.error is not None:
            raise self.error
        return super().snapshot


@pytest.fixture(scope="module")
def models(tmp_path_factory: pytest.TempPathFactory) -> FailingModels:
    """Return models of every kind of context."""
    registry, _ = all_fake_models(tmp_path_factory.mktemp("failures") / "models")
    found = FailingModels(registry)
    found.refresh()
    return found


@pytest.fixture(autouse=True)
def _repaired(models: FailingModels) -> Iterator[None]:
    """Repair the models after each test."""
    yield
    models.error = models.prediction = None


class BrokenProvider(TracerProvider):
    """A provider of spans whose library has a bug."""

    def get_tracer(self, *_: Any, **__: Any) -> Any:
        """Return a tracer that fails."""
        return self

    def start_span(self, *_: Any, **__: Any) -> Any:
        """Fail."""
        raise ZeroDivisionError("a bug of the tracing")


def rings(app: Service) -> ASGIApp:
    """Return the whole application."""
    return app


def framework(app: Service) -> ASGIApp:
    """Return the routes of the framework, without the ring that answers endpoints."""
    admission = Admission(app.framework, AdmissionLimits(1 << 20, 10.0, 64, 0, 1 << 24), Callers(Keys(None)))
    return RequestTelemetry(admission, problem_response, RequestLog(io.StringIO()), app.requests)


def traced(app: Service) -> ASGIApp:
    """Return the application in a ring of spans."""
    return Tracing(app, TracerProvider())


def traced_by_a_broken_library(app: Service) -> ASGIApp:
    """Return the application in a ring of spans that fails."""
    return Tracing(app, BrokenProvider())


def create(models: LoadedModels, **settings: Any) -> Service:
    """Create an application that does not poll."""
    return create_app(
        Settings(poll_interval_s=3600, probe_interval_s=3600, **settings), models, RequestLog(io.StringIO())
    )


@pytest.fixture(scope="module")
def asked(models: FailingModels) -> list[tuple[str, str]]:
    """Return method and path of every route that needs models."""
    found = [("GET", "/metrics")]
    for template, operations in create(models).openapi()["paths"].items():
        if template not in WITHOUT_MODELS:
            path = template.replace("{name}", "push-indicator").replace("{version}", "1")
            assert "{" not in path, "a new parameter: add a value for it"
            found += [(method.upper(), path) for method in operations]
    assert len(found) > 15
    return found


def ask(client: TestClient, method: str, path: str) -> Response:
    """Send a request whose headers are those that the route takes."""
    content_type = "image/png" if path.endswith("image") else "application/json"
    headers = {"X-Request-ID": ID, "Content-Type": content_type}
    return client.request(method, path, headers=headers, content=b"{}" if method == "POST" else None)


def check(response: Response, caplog: pytest.LogCaptureFixture) -> None:
    """Check that a 500 has its id and no cause, and that the log has the cause under the id, once."""
    assert response.status_code == 500, response.text
    assert response.headers["x-request-id"] == ID
    assert CAUSE not in response.text
    document = response.json()
    assert document.get("request_id", ID) == ID
    assert "error" in document or document["code"] in ("internal", "prediction")
    check_log(caplog)


def check_log(caplog: pytest.LogCaptureFixture) -> None:
    """Check that the log has the cause under the id, once."""
    logged = [record for record in caplog.records if record.__dict__.get("request_id") == ID]
    assert len(logged) == 1
    assert logged[0].levelno == logging.ERROR
    assert CAUSE in logging.Formatter().format(logged[0])
    caplog.clear()


@each_error
@pytest.mark.parametrize("way", [rings, framework, traced, traced_by_a_broken_library], ids=lambda way: way.__name__)
def test_every_route_logs_the_cause_of_its_500(
    models: FailingModels,
    asked: list[tuple[str, str]],
    way: Callable[[Service], ASGIApp],
    error: BaseException,
    caplog: pytest.LogCaptureFixture,
) -> None:
    """Each route that reads the models answers with a problem, and its cause is in the log under the id."""
    app = create(models)
    with TestClient(app):
        client = TestClient(way(app), raise_server_exceptions=False)
        models.error = error
        for method, path in asked:
            check(ask(client, method, path), caplog)


BODIES: dict[str, Any] = {
    "/v1/predict": PUSH,
    "/v1/predict/batch": {"pushers": [[-0.075, 0.0, 0.0]] * 2, "contexts": [PUSH["context"]]},
    "a thread": {"pushers": [[-0.075, 0.0, 0.0]] * 1000, "contexts": [PUSH["context"]]},
    "/v2/models/push-none/infer": {
        "inputs": [{"name": "pusher", "datatype": "FP32", "shape": [1, 3], "data": [-0.075, 0.0, 0.0]}]
    },
}


@each_error
@pytest.mark.parametrize("way", [rings, framework, traced], ids=lambda way: way.__name__)
@pytest.mark.parametrize("name", BODIES)
def test_a_prediction_that_fails_is_logged(
    models: FailingModels,
    way: Callable[[Service], ASGIApp],
    error: BaseException,
    name: str,
    caplog: pytest.LogCaptureFixture,
) -> None:
    """A failure of the runtime is logged from the micro-batch, from the event loop and from a thread."""
    app = create(models)
    with TestClient(app):
        client = TestClient(way(app), raise_server_exceptions=False)
        path = name if name.startswith("/") else "/v1/predict/batch"
        models.prediction = None
        headers = {"X-Request-ID": ID}
        assert client.post(path, json=BODIES[name], headers=headers).status_code == 200
        caplog.clear()
        models.prediction = error
        check(client.post(path, json=BODIES[name], headers=headers), caplog)


@each_error
@pytest.mark.parametrize("attribute", ["error", "prediction"])
def test_the_shortcut_logs_the_cause_of_its_500(
    models: FailingModels, error: BaseException, attribute: str, caplog: pytest.LogCaptureFixture
) -> None:
    """A plain push on a connection is answered without ASGI, and its failure is logged in the same way."""
    body = json.dumps(PUSH).encode()
    head = (
        f"POST /v1/predict HTTP/1.1\r\nHost: x\r\nX-Request-ID: {ID}\r\nContent-Type: application/json\r\n"
        f"Content-Length: {len(body)}\r\n\r\n"
    )

    async def scenario() -> bytes:
        """Send the push on a connection."""
        app = create(models)
        connection = FakeConnection(app, app.shortcut)
        setattr(models, attribute, error)
        connection.receive(head.encode() + body)
        return await connection.answers(1)

    received = asyncio.run(scenario())
    assert received.startswith(b"HTTP/1.1 500 ")
    assert ID.encode() in received
    assert CAUSE.encode() not in received
    check_log(caplog)


@each_error
def test_the_separate_port_for_metrics_logs_the_cause_of_its_500(
    models: FailingModels, error: BaseException, caplog: pytest.LogCaptureFixture
) -> None:
    """A collector that fails is a 500 with its cause in the log."""
    app = create(models, metrics_port=9100)
    with TestClient(app):
        client = TestClient(app.metrics, raise_server_exceptions=False)
        models.error = error
        check(ask(client, "GET", "/metrics"), caplog)


def test_a_500_that_the_framework_raises_is_logged(models: FailingModels, caplog: pytest.LogCaptureFixture) -> None:
    """A route may raise the framework's own exception for a 500."""
    app = create(models)

    @app.get("/fails")
    async def fails() -> None:
        """Fail."""
        raise HTTPException(500, CAUSE)

    install_error_handlers(app)
    with TestClient(app, raise_server_exceptions=False) as client:
        check(ask(client, "GET", "/fails"), caplog)


def test_a_fault_of_metrics_or_logs_is_none_of_the_request(
    models: FailingModels, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """A request is answered although it cannot be counted, and the log says so."""
    app = create(models)

    def fail(_: object) -> None:
        raise ZeroDivisionError(CAUSE)

    monkeypatch.setattr(app.requests, "note", fail)
    with TestClient(app) as client:
        assert client.post("/v1/predict", json=PUSH, headers={"X-Request-ID": ID}).status_code == 200
    check_log(caplog)
