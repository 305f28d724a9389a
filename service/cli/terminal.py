"""Options and output of all commands: ``--registry``, ``--json``, and exit statuses that scripts can rely on.

0  done                               3  refused by a gate
1  failed, or a version is broken     4  changed by another writer, or in use
2  wrong command line                 5  no such model, version or alias
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


def _default_registry() -> str:
    """Return the registry of the settings file, for commands without --registry and CAZSL_REGISTRY."""
    try:
        return configure({}).settings.registry if os.environ.get(CONFIG_NAME) else "models"
    except CazslError as error:
        raise click.ClickException(str(error)) from error


registry_option = click.option(
    "--registry",
    envvar="CAZSL_REGISTRY",
    default=_default_registry,
    show_default="models",
    help="Registry of models: a folder, or s3://bucket/prefix.",
)
json_option = click.option("--json", "as_json", is_flag=True, help="Print one JSON document instead of text.")


def errors_as_one_line(command: Callable[P, None]) -> Callable[P, None]:
    """Print a ``CazslError`` of a command as one line, or as one JSON document, and exit with its status."""

    @functools.wraps(command)
    def run(*args: P.args, **kwargs: P.kwargs) -> None:
        try:
            command(*args, **kwargs)
        except CazslError as error:
            if kwargs.get("as_json"):
                print_json({"code": error.code, "detail": str(error)})
            else:
                click.echo(f"Error: {error}", err=True)
            sys.exit(next(status for kind, status in _STATUSES if isinstance(error, kind)))

    return run


def print_json(document: Any) -> None:
    """Print one JSON document."""
    click.echo(json.dumps(document, indent=2))
