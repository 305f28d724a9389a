"""Readiness follows the self-checks of the loaded models, in both directions."""

import asyncio
import shutil
import threading
from dataclasses import dataclass, field
from pathlib import Path

import pytest
from fastapi.testclient import TestClient

from service.app import create_app
from service.errors import ModelNotReadyError, PredictionError
from service.inference.loaded_models import LoadedModels
from service.inference.readiness import Readiness
from service.model.tensors import ContextKind, FloatArray, Gaussians, IndexArray
from service.registry.registry import Registry
from service.settings import Settings
from tests.fakes import LYING, FakePredictor, load_fake, publish_fake


@dataclass
class FaultyPredictor(FakePredictor):
    """A predictor with a fault that a test sets: it fails, lies, hangs or has a bug."""

    fault: list[str] = field(default_factory=list)
    released: threading.Event = field(default_factory=threading.Event)

    def predict(
        self, pusher: FloatArray, contexts: tuple[FloatArray, ...], context_index: IndexArray | None
    ) -> Gaussians:
        """See ``FakePredictor``."""
        if "fails" in self.fault:
            raise PredictionError("the runtime could not evaluate the model")
        if "has a bug" in self.fault:
            raise ZeroDivisionError
        if "hangs" in self.fault:
            self.released.wait()
        found = super().predict(pusher, contexts, context_index)
        return found._replace(mean=found.mean + 1.0) if "lies" in self.fault else found


@pytest.fixture
def predictor() -> FaultyPredictor:
    """Return the predictor of the only model."""
    return FaultyPredictor(b"", takes_context=True)


@pytest.fixture
def models(tmp_path: Path, predictor: FaultyPredictor) -> LoadedModels:
    """Return the loaded models of a registry with one model."""
    registry = Registry(tmp_path / "models")
    publish_fake(registry)
    found = LoadedModels(registry, lambda *_: predictor)
    found.refresh()
    return found


@pytest.mark.parametrize(
    ("fault", "reason"),
    [("fails", "cannot be run"), ("lies", "differs by more"), ("hangs", "did not end within"), ("has a bug", "log")],
)
def test_a_model_that_stops_answering_is_not_ready_until_it_answers_again(
    models: LoadedModels, predictor: FaultyPredictor, fault: str, reason: str
) -> None:
    """A model is ready again as soon as its self-check passes in time, whatever its fault was."""
    readiness = Readiness(models, 2.0, 0.05)

    async def scenario() -> None:
        """Run the scenario in an event loop."""
        await readiness.probe()
        assert (readiness.is_ready(), readiness.reason()) == (True, None)
        predictor.fault.append(fault)
        await readiness.probe()
        (check,) = readiness.checks()
        assert not check.ready
        assert reason in str(check.reason)
        assert "not ready, looking again every 2 s, because push-indicator@1" in str(readiness.reason())
        assert readiness.failures["push-indicator"] == 1
        predictor.fault.clear()
        predictor.released.set()
        while not readiness.is_ready():
            await readiness.probe()

    asyncio.run(scenario())


def test_a_hanging_model_takes_one_thread(models: LoadedModels, predictor: FaultyPredictor) -> None:
    """A self-check that did not end is awaited, and not started again."""
    readiness = Readiness(models, 2.0, 0.01)
    predictor.fault.append("hangs")

    async def scenario() -> None:
        """Run the scenario in an event loop."""
        before = threading.active_count()
        for _ in range(5):
            await readiness.probe()
        assert threading.active_count() == before + 1
        predictor.released.set()

    asyncio.run(scenario())


def test_an_empty_registry_is_not_ready_until_it_is_filled(tmp_path: Path) -> None:
    """An empty registry is a 503 with its reason, and the first model makes it a 200 without a restart."""
    models = LoadedModels(Registry(tmp_path / "models"), load_fake)
    with TestClient(create_app(Settings(poll_interval_s=0.02), models)) as client:
        response = client.get("/readyz")
        assert response.status_code == 503
        assert response.json()["ready"] is False
        assert response.json()["reason"].startswith("not ready, looking again every 0.02 s, because ")
        assert client.get("/livez").status_code == 200
        assert client.get("/v2/health/ready").status_code == 503
        publish_fake(Registry(tmp_path / "models"))
        while client.get("/readyz").status_code != 200:
            pass
        assert client.get("/readyz").json()["checks"] == [
            {"name": "push-indicator", "version": 1, "ready": True, "reason": None}
        ]


def verdict(registry: Registry) -> str | None:
    """Return why a new process that serves this registry is not ready, or None."""
    models = LoadedModels(registry, load_fake)
    models.refresh()
    readiness = Readiness(models, 2.0, 1.0)
    assert readiness.is_ready() == (readiness.reason() is None)
    return readiness.reason()


def test_default_models_that_never_had_a_champion_are_not_waited_for(tmp_path: Path) -> None:
    """A registry with one default model is ready, and stays so while a version of another one is not promoted yet."""
    registry = Registry(tmp_path / "models")
    publish_fake(registry)
    assert verdict(registry) is None
    publish_fake(registry, "push-visual", ContextKind.VISUAL, alias=None)
    publish_fake(registry, "zzz", model=LYING)
    assert verdict(registry) is None


def test_recorded_default_model_that_does_not_answer_is_not_ready(tmp_path: Path) -> None:
    """A new process is not ready while the champion of a default model is broken, until the champion is dropped."""
    registry = Registry(tmp_path / "models")
    publish_fake(registry)
    publish_fake(registry, "push-visual", ContextKind.VISUAL, model=LYING)
    reason = str(verdict(registry))
    assert "push-visual@champion does not answer: push-visual@1 is broken and not served" in reason
    models = LoadedModels(registry, load_fake)
    models.refresh()
    assert models.snapshot.find_default(ContextKind.INDICATOR).manifest.version == 1
    with pytest.raises(ModelNotReadyError, match="push-visual@champion is not served now"):
        models.snapshot.find_default(ContextKind.VISUAL)
    registry.drop_alias("push-visual", "champion")
    assert verdict(registry) is None


def test_no_default_model_is_not_ready(tmp_path: Path) -> None:
    """Models that a request must name do not make the service ready. Neither does a dropped champion."""
    registry = Registry(tmp_path / "models")
    publish_fake(registry, "zzz")
    publish_fake(registry, alias="canary")
    assert "no default model has a champion (push-none, push-indicator, push-visual, push-shape, push-anp)" in str(
        verdict(registry)
    )
    registry.point_alias("push-indicator", "champion", 1)
    assert verdict(registry) is None
    registry.drop_alias("push-indicator", "champion")
    assert "no default model has a champion" in str(verdict(registry))


def test_one_failing_default_model_is_not_ready(tmp_path: Path) -> None:
    """A default model whose probe fails is not ready, although another one answers. Other models do not count."""
    failing = FaultyPredictor(b"", takes_context=True)
    registry = Registry(tmp_path / "models")
    publish_fake(registry)
    publish_fake(registry, "push-none", ContextKind.NONE)
    models = LoadedModels(registry, lambda *load: failing if len(load[1]) > 1 else load_fake(*load))
    models.refresh()
    failing.fault.append("fails")
    readiness = Readiness(models, 2.0, 1.0)
    asyncio.run(readiness.probe())
    assert "because push-indicator@1: " in str(readiness.reason())
    assert models.snapshot.find_default(ContextKind.NONE).manifest.name == "push-none"


def test_a_missing_registry_leaves_the_service_ready(models: LoadedModels, tmp_path: Path) -> None:
    """Loaded models stay served, and readiness lists the problem."""
    with TestClient(create_app(Settings(poll_interval_s=0.02), models)) as client:
        shutil.rmtree(tmp_path / "models")
        while not client.get("/readyz").json()["problems"]:
            pass
        assert client.get("/readyz").status_code == 200


def test_a_failing_version_is_not_ready_under_v2(models: LoadedModels, predictor: FaultyPredictor) -> None:
    """Clients of KServe and Triton read the readiness of each model."""
    with TestClient(create_app(Settings(poll_interval_s=3600, probe_interval_s=0.02), models)) as client:
        assert client.get("/v2/models/push-indicator/ready").status_code == 200
        predictor.fault.append("fails")
        while client.get("/v2/models/push-indicator/ready").status_code == 200:
            pass
        assert "cannot be run" in client.get("/v2/models/push-indicator/versions/1/ready").json()["error"]
        assert client.get("/readyz").status_code == 503


def test_a_draining_service_is_not_ready(models: LoadedModels) -> None:
    """After SIGTERM, readiness tells a load balancer to send no more requests."""
    app = create_app(Settings(poll_interval_s=3600), models)
    with TestClient(app) as client:
        app.parts.readiness.drain()
        response = client.get("/readyz")
        assert (response.status_code, "SIGTERM" in response.json()["reason"]) == (503, True)


def test_a_hanging_registry_does_not_delay_liveness(tmp_path: Path) -> None:
    """If the registry does not answer at the start, /livez answers, and /readyz reports that it was not read yet."""
    released = threading.Event()

    class Hanging(Registry):
        """A registry whose disk does not answer."""

        def fingerprint(self) -> object:
            """Wait until the test allows it."""
            released.wait()
            return super().fingerprint()

    models = LoadedModels(Hanging(tmp_path), load_fake)
    with TestClient(create_app(Settings(), models)) as client:
        assert client.get("/livez").status_code == 200
        assert "was not read yet" in client.get("/readyz").json()["reason"]
        released.set()
