"""``cazsl keys``: create API keys, and check the file that holds them."""

import errno
import os
import select
import sys
from pathlib import Path
from typing import Any, Final

import click

from service.cli.command_line import FILE, argument, errors_as_one_line, json_option, option
from service.cli.configuration import configure
from service.cli.terminal import FAILED, echo, print_json
from service.errors import SettingsError
from service.files import read_file, without_mark
from service.transport.keys import Grant, KeyFile, Scope, digest_of

_PATIENCE_S: Final = 1.0
_LONGEST_KEY: Final = 4096


@click.group()
def keys() -> None:
    """Create API keys for a service that is started with CAZSL_KEYS, and check its file of keys."""


file_argument = argument("path", metavar="[FILE]", type=FILE, required=False)


@keys.command("new")
@argument("name")
@option(
    "--scope",
    "scopes",
    type=click.Choice([scope.value for scope in Scope]),
    multiple=True,
    default=[Scope.PREDICT.value],
    show_default=True,
    help="Scope of the key. May be given more than once.",
)
@option("--file", "path", type=FILE, help="File of keys. The line is added to it instead of printed.")
@errors_as_one_line
def new_key(name: str, scopes: tuple[str, ...], path: Path | None) -> None:
    """Create an API key for NAME. The line for the file of keys goes to standard output, the key to standard error.

    The key is shown this once and stored nowhere. NAME has 1 to 64 letters, digits, '.', '_' and '-'.

    \b
    cazsl keys new robot-7 --file /etc/cazsl/keys
    cazsl keys new robot-7 >> /etc/cazsl/keys
    """
    grant, key = Grant.new(name, frozenset(Scope(scope) for scope in scopes))
    if path is None:
        _show(key)
        echo(grant.line())
        return
    before = _content_without(name, path)
    line = ("\n" if before and not before.endswith(b"\n") else "") + grant.line() + "\n"
    # A new file is readable by its owner only.
    descriptor = os.open(path, os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_NONBLOCK | os.O_CLOEXEC, 0o600)
    try:
        _show(key)  # before its line is in the file: a key that was not seen is of no use
        if os.write(descriptor, line.encode()) < len(line):  # in one write, so that no reading finds a part
            raise OSError(errno.ENOSPC, f"{os.strerror(errno.ENOSPC)}: the last line is not whole", str(path))
    finally:
        os.close(descriptor)


def _show(key: str) -> None:
    echo(f"API key (shown only now): {key}", err=True)


@keys.command("list")
@file_argument
@json_option
@errors_as_one_line
def list_keys(path: Path | None, as_json: bool) -> None:
    """List the keys of FILE with their scopes, and the first digits of their SHA-256. The default is CAZSL_KEYS."""
    found = KeyFile.read(_wanted(path))
    if as_json:
        print_json([_document(grant) for grant in found.grants.values()])
        return
    for grant in found.grants.values():
        echo(f"{grant.name}  {','.join(sorted(grant.scopes))}  {grant.sha256.hex()[:12]}")
    for problem in found.problems:
        echo(f"PROBLEM  {problem}", err=True)


@keys.command("check")
@file_argument
@json_option
@errors_as_one_line
def check_keys(path: Path | None, as_json: bool) -> None:
    """Check every line of FILE. With a key on standard input, print its name and scopes. The default is CAZSL_KEYS.

    Exit status 1 if a line is not valid, or the key is not in the file.

    \b
    cazsl keys check /etc/cazsl/keys
    cazsl keys check /etc/cazsl/keys < key.txt
    """
    found, key = KeyFile.read(_wanted(path)), _key_on_standard_input()
    owner = found.grants.get(digest_of(key)) if key else None
    if as_json:
        document: dict[str, Any] = {"keys": len(found.grants), "problems": list(found.problems)}
        print_json(document | ({"key": None if owner is None else _document(owner)} if key else {}))
    else:
        for problem in found.problems:
            echo(f"PROBLEM  {problem}", err=True)
        echo(f"{len(found.grants)} keys, {len(found.problems)} problems")
        if owner is not None:
            echo(f"the key is that of {owner.name}, with {', '.join(sorted(owner.scopes))}")
        elif key:
            echo("the key on standard input is not in the file", err=True)
    if found.problems or (key and owner is None):
        sys.exit(FAILED)


def _document(grant: Grant) -> dict[str, Any]:
    return {"name": grant.name, "scopes": sorted(grant.scopes), "sha256": grant.sha256.hex()}


def _wanted(path: Path | None) -> Path:
    """Return the file of the argument, or that of the settings."""
    found = path or configure({}).settings.keys
    if found is None:
        raise click.UsageError("received no FILE, and CAZSL_KEYS is not set. Send one of them.")
    return found


def _content_without(name: str, path: Path) -> bytes:
    """Return the content of a file of keys that does not exist yet, or lacks a name."""
    try:
        content = read_file(path)
    except FileNotFoundError:
        return b""
    if any(grant.name == name for grant in KeyFile.parse(content).grants.values()):
        raise SettingsError(f"{path}: has a key for {name} already. Send another name, or remove that line.")
    return content


def _key_on_standard_input() -> bytes:
    """Return the key on standard input, or nothing on a terminal and on a pipe that stays silent."""
    stream = sys.stdin.buffer
    if sys.stdin.isatty():
        return b""
    try:
        silent = not select.select([stream], [], [], _PATIENCE_S)[0]
    except (OSError, ValueError):  # no file of the system: it can be read at once
        silent = False
    return b"" if silent else without_mark(stream.readline(_LONGEST_KEY)).strip()
