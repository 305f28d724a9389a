"""A client of the whole application over fake models of every kind."""

from collections.abc import Iterator

import pytest
from fastapi.testclient import TestClient

from service.app import create_app
from service.model.tensors import ContextKind
from service.settings import Settings
from tests.fakes import fake_models, publish_fake


@pytest.fixture(scope="module")
def client(tmp_path_factory: pytest.TempPathFactory) -> Iterator[TestClient]:
    """Return a client of the application over fake models of every kind."""
    registry, models = fake_models(tmp_path_factory.mktemp("models"))
    publish_fake(registry, "push-visual", ContextKind.VISUAL)
    publish_fake(registry, "push-shape", ContextKind.SHAPE)
    publish_fake(registry, "push-anp", ContextKind.SUPPORT)
    publish_fake(registry, alias="canary")
    models.refresh()
    app = create_app(Settings(poll_interval_s=3600, max_body_bytes=1 << 20), models)
    with TestClient(app, raise_server_exceptions=False) as found:
        yield found
