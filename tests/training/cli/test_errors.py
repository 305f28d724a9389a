"""What commands tell a person when they cannot go on."""

from collections.abc import Callable
from pathlib import Path

import click
import pytest

from service.errors import DataError
from training.cli.errors import mend


def failing(error: Exception) -> Callable[[], None]:
    """A command that fails like this."""

    @mend
    def command() -> None:
        raise error

    return command


def test_an_error_of_ours_is_its_own_line() -> None:
    """The message of the error, as it is."""
    with pytest.raises(click.ClickException, match=r"^the file is broken; fetch it again$"):
        failing(DataError("the file is broken; fetch it again"))()


def test_a_file_that_the_system_refuses_is_named(tmp_path: Path) -> None:
    """The path, what the system said, and what to do."""

    @mend
    def command() -> None:
        (tmp_path / "nowhere" / "file").write_bytes(b"")

    with pytest.raises(
        click.ClickException, match="No such file or directory; mend that or name another path"
    ) as caught:
        command()
    assert caught.value.message.startswith(str(tmp_path / "nowhere" / "file"))


@pytest.mark.parametrize("error", [BrokenPipeError(), ZeroDivisionError()], ids=["no path", "a mistake of ours"])
def test_anything_else_is_seen_whole(error: Exception) -> None:
    """A fault that no person can mend by a path keeps its traceback."""
    with pytest.raises(type(error)):
        failing(error)()
