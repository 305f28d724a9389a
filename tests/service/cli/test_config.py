"""Tests of ``cazsl config``."""

import json
from pathlib import Path

from click.testing import CliRunner

from service.cli.main import main
from service.settings import Settings


def test_every_setting_is_shown_with_its_value_and_its_origin(tmp_path: Path) -> None:
    """Every setting is one line with its value and its source: default, file, environment or option."""
    path = tmp_path / "cazsl.toml"
    path.write_text("grace_s = 7\n")
    result = CliRunner().invoke(
        main, ["config", "--port", "9000", "--config", str(path)], env={"CAZSL_LOG_LEVEL": "DEBUG"}
    )
    assert result.exit_code == 0, result.output
    rows = {line.split()[0]: " ".join(line.split()[1:]) for line in result.output.splitlines()}
    assert list(rows) == list(Settings.model_fields)
    assert rows["port"] == "9000 option --port"
    assert rows["grace_s"] == f"7 file {path}"
    assert rows["log_level"] == "DEBUG environment CAZSL_LOG_LEVEL"
    assert rows["host"] == "127.0.0.1 default"


def test_config_prints_json() -> None:
    """The JSON document of ``cazsl config`` holds each value with its type and its source."""
    result = CliRunner().invoke(main, ["config", "--json"], env={"CAZSL_PORT": "9000", "CAZSL_KEYS": "/etc/keys"})
    found = json.loads(result.output)
    assert found["port"] == {"value": 9000, "from": "environment", "name": "CAZSL_PORT"}
    assert found["keys"]["value"] == "/etc/keys"


def test_serve_and_config_refuse_the_same_settings() -> None:
    """An unknown setting ends ``serve`` and ``config`` with exit status 1 and one line, without a traceback."""
    for command in ("serve", "config"):
        result = CliRunner().invoke(main, [command], env={"CAZSL_PROT": "1"})
        assert result.exit_code == 1
        assert result.output.startswith("Error: CAZSL_PROT: unknown setting")
        assert len(result.output.splitlines()) == 1


def test_commands_use_the_registry_of_the_settings_file(tmp_path: Path, project_root: Path) -> None:
    """Commands without --registry use the registry of the settings file. An invalid file is an error of one line."""
    path = tmp_path / "cazsl.toml"
    path.write_text(f'registry = "{project_root / "models"}"\n')
    listed = CliRunner().invoke(main, ["models", "list"], env={"CAZSL_CONFIG": str(path)})
    assert "push-indicator" in listed.output
    path.write_text("registry = 7\n")
    refused = CliRunner().invoke(main, ["models", "list"], env={"CAZSL_CONFIG": str(path)})
    assert (refused.exit_code, len(refused.output.splitlines())) == (1, 1)
    assert "registry: Input should be a valid string" in refused.output
