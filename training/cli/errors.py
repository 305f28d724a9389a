"""What a person sees when a command cannot do its work: one line that names the fault, and exit status 1."""

import functools
from collections.abc import Callable
from typing import ParamSpec

import click

from service.errors import CazslError

P = ParamSpec("P")


def mend(command: Callable[P, None]) -> Callable[P, None]:
    """An error of ours, or a file that the system refuses, becomes one line and exit status 1."""

    @functools.wraps(command)
    def run(*args: P.args, **kwargs: P.kwargs) -> None:
        try:
            command(*args, **kwargs)
        except CazslError as error:
            raise click.ClickException(str(error)) from error
        except OSError as error:
            if error.filename is None:  # nothing a person could mend by a path: let it be seen whole
                raise
            raise click.ClickException(f"{error.filename}: {error.strerror}; mend that or name another path") from error

    return run
