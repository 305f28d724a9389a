"""``cazsl config`` shows what is in force."""

import json
from pathlib import Path

from click.testing import CliRunner

from service.cli.main import main
from service.settings import Settings


def test_every_setting_is_shown_with_its_value_and_its_origin(tmp_path: Path) -> None:
    """One line each: default, file, environment or option."""
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


def test_scripts_read_it_as_json() -> None:
    """Values with their types, and where they came from."""
    result = CliRunner().invoke(main, ["config", "--json"], env={"CAZSL_PORT": "9000", "CAZSL_KEYS": "/etc/keys"})
    found = json.loads(result.output)
    assert found["port"] == {"value": 9000, "from": "environment", "name": "CAZSL_PORT"}
    assert found["keys"]["value"] == "/etc/keys"


def test_serving_and_showing_refuse_the_same() -> None:
    """One line, exit status 1, no traceback."""
    for command in ("serve", "config"):
        result = CliRunner().invoke(main, [command], env={"CAZSL_PROT": "1"})
        assert result.exit_code == 1
        assert result.output.startswith("Error: CAZSL_PROT: received a name that is no setting")
        assert len(result.output.splitlines()) == 1


def test_every_command_finds_the_registry_of_the_file(tmp_path: Path, project_root: Path) -> None:
    """What the service serves is what `cazsl models` lists, without saying it twice; a broken file is one line."""
    path = tmp_path / "cazsl.toml"
    path.write_text(f'registry = "{project_root / "models"}"\n')
    listed = CliRunner().invoke(main, ["models", "list"], env={"CAZSL_CONFIG": str(path)})
    assert "push-indicator" in listed.output
    path.write_text("registry = 7\n")
    refused = CliRunner().invoke(main, ["models", "list"], env={"CAZSL_CONFIG": str(path)})
    assert (refused.exit_code, len(refused.output.splitlines())) == (1, 1)
    assert "registry: Input should be a valid string" in refused.output
