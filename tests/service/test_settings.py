"""Settings come from the environment, each with a default that works."""

from pathlib import Path

import pydantic
import pytest

from service.inference.snapshot import DEFAULT_MODELS
from service.model.tensors import ContextKind
from service.settings import Settings


def test_the_defaults_are_a_working_configuration() -> None:
    """Without any setting, the service listens on loopback and bounds bodies."""
    settings = Settings()
    assert (settings.host, settings.port, settings.registry) == ("127.0.0.1", 8000, "models")
    assert settings.max_body_bytes == 12 << 20


def test_variables_of_the_environment_set_fields(monkeypatch: pytest.MonkeyPatch) -> None:
    """CAZSL_<NAME> sets the field of that name."""
    monkeypatch.setenv("CAZSL_PORT", "9001")
    monkeypatch.setenv("CAZSL_REGISTRY", "/srv/models")
    assert (Settings().port, Settings().registry) == (9001, "/srv/models")


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("PORT", "70000"),
        ("PORT", "http"),
        ("POLL_INTERVAL_S", "0"),
        ("MAX_BODY_BYTES", "-1"),
        ("LOG_LEVEL", "LOUD"),
        ("MODEL_SHAPE", "push-shape@1"),
    ],
)
def test_an_impossible_value_is_refused(monkeypatch: pytest.MonkeyPatch, name: str, value: str) -> None:
    """A value outside of the bounds of its field is refused with the name of the field."""
    monkeypatch.setenv(f"CAZSL_{name}", value)
    with pytest.raises(pydantic.ValidationError, match=name.lower()):
        Settings()


def test_each_kind_of_context_has_a_default_model(monkeypatch: pytest.MonkeyPatch) -> None:
    """The default models of all kinds of context are those of the code, and one setting changes one of them."""
    assert Settings().default_models() == DEFAULT_MODELS
    monkeypatch.setenv("CAZSL_MODEL_SHAPE", "mine")
    assert Settings().default_models() == {**DEFAULT_MODELS, ContextKind.SHAPE: "mine"}


def test_every_setting_is_described() -> None:
    """Every setting has a description for operators."""
    assert all(field.description for field in Settings.model_fields.values())


def test_the_documentation_lists_every_setting(project_root: Path) -> None:
    """docs/operations.md lists each setting with its default and its description."""
    text = (project_root / "docs" / "operations.md").read_text(encoding="utf-8")
    for name, field in Settings.model_fields.items():
        assert f"| `CAZSL_{name.upper()}` | `{field.default}` | {field.description} |" in text
