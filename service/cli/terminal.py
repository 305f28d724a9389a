"""Output of all commands, of the trainer's too, and the options ``--registry`` and ``--json``.

``echo`` and ``echo_lines`` are the only ways to a terminal. They escape every character that a terminal could obey,
hide or reorder, because names and texts come from registries, files and folders of other people.

Exit statuses, which scripts can rely on:

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
_STATUSES: Final = ((ConflictError, 4), (InUseError, 4), (UnknownModelError, 5))


def printable(text: str) -> str:
    """Return a text as one line without control characters: ``\\n``, ``\\x1b`` or ``\\u202e`` in their place.

    Escaped are the characters that Unicode calls not printable: controls, formats such as the change of direction,
    separators other than the space, halves of a character (from names that are not UTF-8), and unassigned ones.
    """
    if text.isprintable():
        return text
    return "".join(each if each.isprintable() else each.encode("unicode_escape").decode() for each in text)


def echo(text: str, err: bool = False) -> None:
    """Print one line to standard output, or to standard error.

    Raises:
        OSError: the stream is closed or full.
    """
    _write(printable(text), err)


def echo_lines(text: str, err: bool = False) -> None:
    """Print a text of several lines, such as a table or a card. Its line feeds are kept, and no other control.

    Raises:
        OSError: the stream is closed or full.
    """
    _write("\n".join(map(printable, text.split("\n"))), err)


def print_json(document: Any) -> None:
    """Print one JSON document, in ASCII: other characters are escaped."""
    echo_lines(json.dumps(document, indent=2).replace("\x7f", "\\u007f"))  # the one control that JSON leaves alone


def confirm(question: str) -> bool:
    """Ask a question on the terminal and return True for yes."""
    return click.confirm(printable(question), err=True)


def _write(text: str, err: bool) -> None:
    """Write a text. A character that the encoding of the stream lacks is escaped: LANG=C has ASCII alone."""
    encoding = getattr(sys.stderr if err else sys.stdout, "encoding", None) or "utf-8"
    click.echo(text.encode(encoding, "backslashreplace").decode(encoding), err=err)


def status_of(error: CazslError) -> int:
    """Return the exit status of an error."""
    return next((status for kind, status in _STATUSES if isinstance(error, kind)), FAILED)


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
                echo(f"Error: {error}", err=True)
            sys.exit(status_of(error))

    return run
