"""Output of all commands, of the trainer's too, and their exit statuses.

``echo`` and ``echo_lines`` are the only ways to a terminal. They escape every character that a terminal could obey,
hide or reorder, because names and texts come from registries, files and folders of other people.

Exit statuses, which scripts can rely on:

0  done                               3  refused by a gate
1  failed, or a version is broken     4  changed by another writer, or in use
2  wrong command line                 5  no such model, version or alias
"""

import errno
import json
import os
import sys
from pathlib import Path
from typing import Any, Final

import click

from service.errors import CazslError, ConflictError, InUseError, UnknownModelError

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
        click.ClickException: the stream is closed or full.
    """
    _write(printable(text), err)


def echo_lines(text: str, err: bool = False) -> None:
    """Print a text of several lines, such as a table or a card. Its line feeds are kept, and no other control.

    Raises:
        click.ClickException: the stream is closed or full.
    """
    _write("\n".join(map(printable, text.split("\n"))), err)


def print_json(document: Any) -> None:
    """Print one JSON document, in ASCII: other characters are escaped."""
    echo_lines(json.dumps(document, indent=2).replace("\x7f", "\\u007f"))  # the one control that JSON leaves alone


def confirm(question: str) -> bool:
    """Ask a question on the terminal and return True for yes."""
    return click.confirm(printable(question), err=True)


def open_streams() -> None:
    """Replace standard streams that are closed, as by ``>&-``, before a file of ours gets the number of one.

    Writing to the one for standard output fails, as it should: the output is lost. That for standard error takes the
    lines of libraries and logs. ``echo`` refuses it.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDONLY)  # the lowest free number
    streams = vars(sys)
    if streams["stdout"] is None:
        sys.stdout = open(os.open(os.devnull, os.O_RDONLY), "w", encoding="utf-8")  # noqa: PTH123, SIM115
    if streams["stderr"] is None:
        sys.stderr = Path(os.devnull).open("w", encoding="utf-8")  # noqa: SIM115
    if streams["stdin"] is None:
        sys.stdin = Path(os.devnull).open(encoding="utf-8")  # noqa: SIM115


def release_streams() -> bool:
    """Return True if all output was written. Otherwise drop the rest, which Python would try to write at its end."""
    complete = True
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except OSError:
            complete = False
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
    return complete


def _write(text: str, err: bool) -> None:
    """Write a text. A character that the encoding of the stream lacks is escaped: LANG=C has ASCII alone."""
    stream, name = (sys.stderr, "standard error") if err else (sys.stdout, "standard output")
    encoding = getattr(stream, "encoding", None) or "utf-8"
    try:
        if getattr(stream, "name", None) == os.devnull:
            raise OSError(errno.EBADF, os.strerror(errno.EBADF))
        click.echo(text.encode(encoding, "backslashreplace").decode(encoding), err=err)
    except OSError as error:
        raise click.ClickException(f"{name}: {error.strerror}") from error


def status_of(error: CazslError) -> int:
    """Return the exit status of an error."""
    return next((status for kind, status in _STATUSES if isinstance(error, kind)), FAILED)
