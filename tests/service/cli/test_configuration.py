"""What is in force, who said so, and nothing ignored in silence."""

from pathlib import Path

import pytest

from service.cli.configuration import MASK, Configuration, configure, masked
from service.errors import SettingsError


def write(folder: Path, text: str) -> Path:
    """A file of settings."""
    path = folder / "cazsl.toml"
    path.write_text(text, encoding="utf-8")
    return path


def origin(found: Configuration, name: str) -> str:
    """Where a value came from, in words."""
    return str(found.origins[name])


def test_options_win_over_the_environment_the_environment_over_the_file(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Each value says where it came from; an option that was not given says nothing."""
    path = write(tmp_path, 'host = "::1"\nport = 1\ngrace_s = 3\n')
    monkeypatch.setenv("CAZSL_PORT", "2")
    monkeypatch.setenv("CAZSL_HOST", "::2")
    found = configure({"host": "::3", "registry": None}, path)
    settings = found.settings
    assert (settings.host, settings.port, settings.grace_s, settings.registry) == ("::3", 2, 3, "models")
    assert [origin(found, name) for name in ("host", "port", "grace_s", "registry")] == [
        "option --host",
        "environment CAZSL_PORT",
        f"file {path}",
        "default",
    ]


def test_the_environment_names_the_file(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """CAZSL_CONFIG, unless the command line names another."""
    monkeypatch.setenv("CAZSL_CONFIG", str(write(tmp_path, "port = 9001")))
    assert configure({}).settings.port == 9001


@pytest.mark.parametrize(
    ("name", "value", "told"),
    [
        ("CAZSL_PROT", "1", "CAZSL_PROT: received a name that is no setting; .* is CAZSL_PORT meant?"),
        ("CAZSL_PORT", "70000", "CAZSL_PORT: Input should be less than .*70000.*port to listen on"),
        ("CAZSL_GRACE_S", "soon", "CAZSL_GRACE_S: .*'soon'.*after SIGTERM, in s"),
        ("CAZSL_PORT", "tcp://10.0.0.1:8000", "CAZSL_PORT: .*enableServiceLinks"),
        ("CAZSL_PORT_8000_TCP", "tcp://10.0.0.1:8000", "CAZSL_PORT_8000_TCP: .*enableServiceLinks"),
        ("CAZSL_CONFIG", "/nowhere/cazsl.toml", "/nowhere/cazsl.toml: received a name of no file"),
    ],
    ids=["unknown", "out of bounds", "no number", "link as value", "link as name", "no file"],
)
def test_what_cannot_be_in_the_environment_is_one_line_that_names_it(
    monkeypatch: pytest.MonkeyPatch, name: str, value: str, told: str
) -> None:
    """And what is accepted, or what may have been meant."""
    monkeypatch.setenv(name, value)
    with pytest.raises(SettingsError, match=told) as refused:
        configure({})
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("prot = 1", "cazsl.toml: prot: .* is port meant?"),
        ("port = 70000", "cazsl.toml: port: Input should be less than"),
        ("[service]\nport = 1", "cazsl.toml: service: received a name that is no setting"),
        ("port = [1, 2]", "cazsl.toml: port: Input should be a valid integer"),
        ("port =", "cazsl.toml: cannot be read as TOML: Invalid value"),
    ],
)
def test_what_cannot_be_in_the_file_is_one_line_that_names_it(tmp_path: Path, text: str, told: str) -> None:
    """The file, the name in it, and why."""
    with pytest.raises(SettingsError, match=told) as refused:
        configure({}, write(tmp_path, text))
    assert "\n" not in str(refused.value)


def test_an_option_that_cannot_be_is_named_as_it_was_written() -> None:
    """Whoever wrote --port reads --port."""
    with pytest.raises(SettingsError, match="--port: Input should be less than"):
        configure({"port": 70000})


def test_credentials_in_an_address_are_not_shown(monkeypatch: pytest.MonkeyPatch) -> None:
    """A registry may be told with a user and a password in front."""
    monkeypatch.setenv("CAZSL_REGISTRY", "s3://me:secret@bucket/models")
    shown = {name: value for name, value, _ in configure({}).lines()}
    assert shown["registry"] == f"s3://{MASK}@bucket/models"
    assert masked(7) == 7
