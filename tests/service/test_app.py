"""The application composes all parts, and polls the registry for as long as it lives."""

from pathlib import Path
from typing import Any

import pytest
from fastapi.testclient import TestClient

from service.app import create_app
from service.inference.loaded_models import LoadedModels
from service.registry.registry import Registry
from service.settings import Settings
from tests.fakes import fake_models, load_fake


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


class BuggyRegistry(Registry):
    """A registry with a bug that its first poll meets."""

    polls = 0

    def fingerprint(self) -> object:
        """Raise an exception that is not of our tree, once."""
        self.polls += 1
        if self.polls == 1:
            raise ZeroDivisionError("the fake has a bug")
        return super().fingerprint()


def test_a_bug_in_a_poll_is_logged_and_does_not_end_the_polling(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """The service starts in spite of an unexpected exception, and polls again."""
    fake_models(tmp_path / "models")
    models = LoadedModels(BuggyRegistry(tmp_path / "models"), load_fake)
    with TestClient(create_app(Settings(poll_interval_s=0.02), models)) as client:
        while client.get("/readyz").status_code != 200:
            pass
    assert "the fake has a bug" in caplog.text
