"""Settings come from the environment, each with a default that works."""

from pathlib import Path

import pydantic
import pytest

from service.settings import Settings


def test_nothing_configured_is_a_working_configuration() -> None:
    """Loopback, the registry beside the project, a bounded body."""
    settings = Settings()
    assert (settings.host, settings.port, settings.registry) == ("127.0.0.1", 8000, "models")
    assert settings.max_body_bytes == 12 << 20


def test_the_environment_decides(monkeypatch: pytest.MonkeyPatch) -> None:
    """CAZSL_<NAME> sets the field of that name."""
    monkeypatch.setenv("CAZSL_PORT", "9001")
    monkeypatch.setenv("CAZSL_REGISTRY", "/srv/models")
    assert (Settings().port, Settings().registry) == (9001, "/srv/models")


@pytest.mark.parametrize(
    ("name", "value"),
    [("PORT", "70000"), ("PORT", "http"), ("POLL_INTERVAL_S", "0"), ("MAX_BODY_BYTES", "-1"), ("LOG_LEVEL", "LOUD")],
)
def test_an_impossible_value_is_refused(monkeypatch: pytest.MonkeyPatch, name: str, value: str) -> None:
    """Bounds are part of every field."""
    monkeypatch.setenv(f"CAZSL_{name}", value)
    with pytest.raises(pydantic.ValidationError, match=name.lower()):
        Settings()


def test_every_setting_is_described() -> None:
    """A field without words is no setting for ops."""
    assert all(field.description for field in Settings.model_fields.values())


def test_every_setting_stands_in_the_documentation_as_it_is(project_root: Path) -> None:
    """docs/operations.md lists each setting with its default and its meaning."""
    text = (project_root / "docs" / "operations.md").read_text(encoding="utf-8")
    for name, field in Settings.model_fields.items():
        assert f"| `CAZSL_{name.upper()}` | `{field.default}` | {field.description} |" in text
