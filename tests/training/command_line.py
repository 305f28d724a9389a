"""The command line of the trainer, run in the process of a test."""

from pathlib import Path

from click.testing import CliRunner, Result

from training.cli.main import main


def cazsl_train(*arguments: str | Path) -> Result:
    """Run a command in this process, and raise an exception that would end in a traceback."""
    result = CliRunner().invoke(main, [str(argument) for argument in arguments])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result


def sole_line(result: Result) -> str:
    """Return the only line of output of a command that failed with exit status 1."""
    assert result.exit_code == 1
    assert result.stdout == ""
    (line,) = result.stderr.splitlines()
    assert line.startswith("Error: ")
    return line
