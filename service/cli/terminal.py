"""What every command shares: the registry option, ``--json``, and exit statuses that scripts can rely on.

0  done                               3  refused by a gate
1  failed, or something is broken     4  somebody else changed it first, or it is in use
2  the command line is wrong          5  there is no such model, version or alias
"""

import functools
import json
import os
import sys
from collections.abc import Callable
from typing import Any, Final, ParamSpec

import click

from service.cli.configuration import CONFIG_NAME, configure
from service.errors import CazslError, ConflictError, InUseError, UnknownModelError

P = ParamSpec("P")
FAILED: Final = 1
REFUSED: Final = 3
_STATUSES: Final = ((ConflictError, 4), (InUseError, 4), (UnknownModelError, 5), (CazslError, FAILED))


def _registry() -> str:
    """The registry of the file of settings, for who gives neither option nor CAZSL_REGISTRY."""
    try:
        return configure({}).settings.registry if os.environ.get(CONFIG_NAME) else "models"
    except CazslError as error:
        raise click.ClickException(str(error)) from error


registry_option = click.option(
    "--registry",
    envvar="CAZSL_REGISTRY",
    default=_registry,
    show_default="models",
    help="The folder of models, or s3://bucket/prefix.",
)
json_option = click.option("--json", "as_json", is_flag=True, help="One JSON document instead of text.")


def mend(command: Callable[P, None]) -> Callable[P, None]:
    """An error of ours becomes one line, or one JSON document, and an exit status."""

    @functools.wraps(command)
    def run(*args: P.args, **kwargs: P.kwargs) -> None:
        try:
            command(*args, **kwargs)
        except CazslError as error:
            if kwargs.get("as_json"):
                say({"code": error.code, "detail": str(error)})
            else:
                click.echo(f"Error: {error}", err=True)
            sys.exit(next(status for kind, status in _STATUSES if isinstance(error, kind)))

    return run


def say(document: Any) -> None:
    """Print one JSON document."""
    click.echo(json.dumps(document, indent=2))
