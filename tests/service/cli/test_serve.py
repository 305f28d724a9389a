"""Tests of ``cazsl serve`` before the service starts. ``tests/test_service_process.py`` tests running services."""

from click.testing import CliRunner

from service.cli.main import main


def test_invalid_setting_ends_the_start_with_one_line() -> None:
    """An invalid setting ends ``cazsl serve`` with exit status 1 and a line that names the setting."""
    result = CliRunner().invoke(main, ["serve"], env={"CAZSL_PORT": "70000"})
    assert result.exit_code == 1
    assert result.output.startswith("Error: CAZSL_PORT")
