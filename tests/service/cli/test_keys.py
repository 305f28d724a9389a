"""Tests of ``cazsl keys``."""

import hashlib

from click.testing import CliRunner

from service.cli.main import main


def test_new_key_prints_the_line_for_the_file_and_the_key_apart() -> None:
    """The line for the file of keys is on standard output, and the key itself only on standard error."""
    result = CliRunner().invoke(main, ["keys", "new", "robot-7", "--scope", "predict", "--scope", "metrics"])
    assert result.exit_code == 0, result.output
    key = result.stderr.split()[-1]
    assert result.stdout == f"robot-7 metrics,predict {hashlib.sha256(key.encode()).hexdigest()}\n"
