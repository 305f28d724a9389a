"""Tests of the ``cazsl`` command group."""

from click.testing import CliRunner

from service.cli.main import main


def test_help_lists_every_command_with_examples() -> None:
    """The help of ``cazsl`` lists the commands, examples of the common ones, and the environment variables."""
    result = CliRunner().invoke(main, ["--help"])
    assert result.exit_code == 0
    for word in ("serve", "models", "predict 1a2b3c4a -- -0.075 0 0", "CAZSL_REGISTRY"):
        assert word in result.output
