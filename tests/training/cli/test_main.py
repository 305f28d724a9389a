"""``cazsl-train``: its commands, their help and the version."""

import pytest

import service
from tests.training.command_line import cazsl_train


def test_help_lists_the_commands() -> None:
    """The help lists each command, and shows the four steps in order."""
    result = cazsl_train("--help")

    assert result.exit_code == 0
    for command in ("simulate", "images", "fit", "evaluate", "publish"):
        assert f"\n  {command} " in result.output, command
    assert result.output.index("cazsl-train simulate") < result.output.index("cazsl-train publish")


@pytest.mark.parametrize("command", ["simulate", "fit", "evaluate", "publish", "reproduce"])
def test_every_command_explains_itself(command: str) -> None:
    """The help of a command has its usage and the default folder of data."""
    result = cazsl_train(command, "-h")

    assert result.exit_code == 0
    assert result.output.startswith("Usage: ")
    assert "data/approach" in result.output


def test_the_version_is_the_package_s() -> None:
    """Trainer and service have one version number."""
    assert cazsl_train("--version").output == f"cazsl-train, version {service.__version__}\n"
