"""Errors of a command: one line that names the fault, and exit status 1."""

import functools
from collections.abc import Callable
from typing import ParamSpec

import click

from service.errors import CazslError

P = ParamSpec("P")


def one_line_errors(command: Callable[P, None]) -> Callable[P, None]:
    """Turn an error of this project, or of the system about a file, into one line and exit status 1."""

    @functools.wraps(command)
    def run(*args: P.args, **kwargs: P.kwargs) -> None:
        try:
            command(*args, **kwargs)
        except CazslError as error:
            raise click.ClickException(str(error)) from error
        except OSError as error:
            if error.filename is None:  # without a path the user cannot fix it: keep the traceback
                raise
            raise click.ClickException(f"{error.filename}: {error.strerror}; fix that or name another path") from error

    return run
