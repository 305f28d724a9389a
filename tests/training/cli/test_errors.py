"""Errors of commands: one line for faults that a user can fix, a traceback for all others."""

from collections.abc import Callable
from pathlib import Path

import click
import pytest

from service.errors import DataError
from training.cli.errors import one_line_errors


def failing(error: Exception) -> Callable[[], None]:
    """Return a command that fails with this error."""

    @one_line_errors
    def command() -> None:
        raise error

    return command


def test_an_error_of_ours_is_its_own_line() -> None:
    """An error of this project becomes one line with its message, unchanged."""
    with pytest.raises(click.ClickException, match=r"^the file is broken; fetch it again$"):
        failing(DataError("the file is broken; fetch it again"))()


def test_a_file_that_the_system_refuses_is_named(tmp_path: Path) -> None:
    """An error of the system about a file becomes one line with its path, the reason and the remedy."""

    @one_line_errors
    def command() -> None:
        (tmp_path / "nowhere" / "file").write_bytes(b"")

    with pytest.raises(
        click.ClickException, match="No such file or directory; fix that or name another path"
    ) as caught:
        command()
    assert caught.value.message.startswith(str(tmp_path / "nowhere" / "file"))


@pytest.mark.parametrize("error", [BrokenPipeError(), ZeroDivisionError()], ids=["no path", "a mistake of ours"])
def test_other_errors_keep_their_traceback(error: Exception) -> None:
    """An error that the user cannot fix by a path is raised unchanged."""
    with pytest.raises(type(error)):
        failing(error)()
