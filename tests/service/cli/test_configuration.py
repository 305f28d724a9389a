"""Tests of settings from options, environment and file: precedence, sources and errors."""

from pathlib import Path

import pytest

from service.cli.configuration import MASK, Configuration, configure, masked
from service.errors import SettingsError


def write(folder: Path, text: str) -> Path:
    """Write a file of settings."""
    path = folder / "cazsl.toml"
    path.write_text(text, encoding="utf-8")
    return path


def origin(found: Configuration, name: str) -> str:
    """Return the source of a value in words."""
    return str(found.origins[name])


def test_options_precede_the_environment_and_the_environment_precedes_the_file(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Options precede the environment, which precedes the file. Every value has its source."""
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
    """CAZSL_CONFIG names the file of settings if no option does."""
    monkeypatch.setenv("CAZSL_CONFIG", str(write(tmp_path, "port = 9001")))
    assert configure({}).settings.port == 9001


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("CAZSL_PROT", "1", r"CAZSL_PROT: unknown setting\. .* Did you mean CAZSL_PORT\?"),
        ("CAZSL_PORT", "70000", "CAZSL_PORT: Input should be less than .*70000.*Port to listen on"),
        ("CAZSL_GRACE_S", "soon", "CAZSL_GRACE_S: .*'soon'.*after SIGTERM, in s"),
        ("CAZSL_PORT", "tcp://10.0.0.1:8000", "CAZSL_PORT: .*enableServiceLinks"),
        ("CAZSL_PORT_8000_TCP", "tcp://10.0.0.1:8000", "CAZSL_PORT_8000_TCP: .*enableServiceLinks"),
        ("CAZSL_CONFIG", "/nowhere/cazsl.toml", "/nowhere/cazsl.toml: there is no such file"),
    ],
    ids=["unknown", "out of bounds", "no number", "link as value", "link as name", "no file"],
)
def test_invalid_environment_variable_is_one_line_with_its_name(
    monkeypatch: pytest.MonkeyPatch, name: str, value: str, message: str
) -> None:
    """An invalid environment variable is one line with its name, and the accepted values or a similar name."""
    monkeypatch.setenv(name, value)
    with pytest.raises(SettingsError, match=message) as refused:
        configure({})
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("prot = 1", r"cazsl.toml: prot: .* Did you mean port\?"),
        ("port = 70000", "cazsl.toml: port: Input should be less than"),
        ("[service]\nport = 1", "cazsl.toml: service: unknown setting"),
        ("port = [1, 2]", "cazsl.toml: port: Input should be a valid integer"),
        ("port =", "cazsl.toml: cannot be read as TOML: Invalid value"),
    ],
)
def test_invalid_entry_of_the_file_is_one_line_with_its_name(tmp_path: Path, text: str, message: str) -> None:
    """An invalid entry is one line with the file, the name in it, and the reason."""
    with pytest.raises(SettingsError, match=message) as refused:
        configure({}, write(tmp_path, text))
    assert "\n" not in str(refused.value)


def test_invalid_option_is_named_as_it_was_written() -> None:
    """An invalid value of --port is an error that names --port."""
    with pytest.raises(SettingsError, match="--port: Input should be less than"):
        configure({"port": 70000})


def test_credentials_in_an_address_are_masked(monkeypatch: pytest.MonkeyPatch) -> None:
    """A user and password in the address of a registry are masked in the output."""
    monkeypatch.setenv("CAZSL_REGISTRY", "s3://me:secret@bucket/models")
    shown = {name: value for name, value, _ in configure({}).lines()}
    assert shown["registry"] == f"s3://{MASK}@bucket/models"
    assert masked(7) == 7
