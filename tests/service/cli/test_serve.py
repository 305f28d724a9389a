"""Tests of ``cazsl serve`` before the service starts. ``tests/test_service_process.py`` tests running services."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner

from service.cli.main import main


def test_invalid_setting_ends_the_start_with_one_line() -> None:
    """An invalid setting ends ``cazsl serve`` with exit status 1 and a line that names the setting."""
    result = CliRunner().invoke(main, ["serve"], env={"CAZSL_PORT": "70000"})
    assert result.exit_code == 1
    assert result.output.startswith("Error: CAZSL_PORT")


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("CAZSL_KEYS", "{folder}/missing"),
        ("CAZSL_KEYS", "{folder}/pipe"),
        ("CAZSL_KEYS", "{folder}"),
        ("CAZSL_KEYS", "/dev/zero"),
        ("CAZSL_REQUIRE_SIGNATURE", ":"),
        ("CAZSL_REQUIRE_SIGNATURE", "{folder}/pipe"),
        ("CAZSL_HOST", "no.such.host.invalid"),
        ("CAZSL_HOST", "a" * 300),
        ("CAZSL_CONFIG", "{folder}/pipe"),
    ],
)
def test_a_value_that_cannot_be_used_ends_the_start_in_one_line(tmp_path: Path, name: str, value: str) -> None:
    """A file that cannot be read, or a host without an address, ends the start in one line that names it."""
    os.mkfifo(tmp_path / "pipe")
    value = value.format(folder=tmp_path)
    done = subprocess.run(
        [sys.executable, "-c", "from service.cli.main import main; main()", "serve"],
        env={**os.environ, "CAZSL_PORT": "0", name: value},
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )
    assert (done.returncode, done.stdout) == (1, "")
    (line,) = done.stderr.splitlines()
    assert line.startswith("Error: ")
    assert name in line or value in line
