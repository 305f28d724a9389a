"""The whole application over fake models."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from fastapi.testclient import TestClient

from service.app import create_app
from service.inference.loaded_models import LoadedModels
from service.registry.registry import Registry
from service.settings import Settings
from tests.fakes import fake_models


@pytest.fixture
def served(tmp_path: Path) -> tuple[Registry, LoadedModels]:
    """Return a registry of fake models with its loaded models."""
    return fake_models(tmp_path / "models")


@pytest.fixture
def client(served: tuple[Registry, LoadedModels]) -> Iterator[TestClient]:
    """Return a client of the whole application, to which exceptions of the server are answers, as with uvicorn."""
    app = create_app(Settings(max_body_bytes=4096, poll_interval_s=3600), served[1])
    with TestClient(app, raise_server_exceptions=False) as found:
        yield found
