"""Clients of the whole application, over fake models and over those that ship."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from fastapi.testclient import TestClient

from service.app import create_app
from service.inference.loaded_models import LoadedModels
from service.model.predictor import OnnxPredictor
from service.model.tensors import ContextKind
from service.registry.registry import Registry
from service.settings import Settings
from tests.fakes import fake_models, publish_fake


@pytest.fixture(scope="module")
def shipped(project_root: Path) -> Iterator[TestClient]:
    """Return a client of the application over the models that ship."""
    models = LoadedModels(Registry(project_root / "models"), OnnxPredictor)
    models.refresh()  # the application awaits its first poll for two seconds, which a busy machine may exceed
    with TestClient(create_app(Settings(poll_interval_s=3600), models), raise_server_exceptions=False) as found:
        yield found


@pytest.fixture(scope="module")
def faked(tmp_path_factory: pytest.TempPathFactory) -> Iterator[TestClient]:
    """Return a client of the application over fake models of every kind of context."""
    registry, models = fake_models(tmp_path_factory.mktemp("models"))
    publish_fake(registry, "push-visual", ContextKind.VISUAL)
    publish_fake(registry, "push-shape", ContextKind.SHAPE)
    publish_fake(registry, "push-anp", ContextKind.SUPPORT)
    models.refresh()
    with TestClient(create_app(Settings(poll_interval_s=3600), models), raise_server_exceptions=False) as found:
        yield found
