"""``cazsl config``: what is in force, and who said so; and the options that serving shares with it."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import click

from service.cli.configuration import Configuration, configure
from service.cli.terminal import json_option, mend, say
from service.errors import CazslError

_OPTIONS: Final = (
    click.option("--host", help="Address to listen on. [default: 127.0.0.1]"),
    click.option("--port", type=int, help="Port to listen on; 0 picks a free one. [default: 8000]"),
    click.option("--registry", help="The folder of models, or s3://bucket/prefix. [default: models]"),
    click.option(
        "--config",
        "path",
        type=click.Path(path_type=Path),
        help="A file of settings in TOML, such as port = 9000. [default: the one that CAZSL_CONFIG names]",
    ),
)


def settings_options(command: Callable[..., None]) -> Callable[..., None]:
    """The options of a command that takes settings."""
    for option in reversed(_OPTIONS):
        command = option(command)
    return command


def configured(options: dict[str, Any]) -> Configuration:
    """What is in force.

    Raises:
        click.ClickException: one line that names what is wrong.
    """
    path: Path | None = options.pop("path")
    try:
        return configure(options, path)
    except CazslError as error:
        raise click.ClickException(str(error)) from error


@click.command("config")
@settings_options
@json_option
@mend
def config(as_json: bool, **options: Any) -> None:
    """Show every setting, its value and where it came from; secrets are masked. Nothing is started.

    \b
    cazsl config --port 9000
    CAZSL_CONFIG=/etc/cazsl/cazsl.toml cazsl config --json
    """
    found = configured(options)
    rows = [(name, _text(value), origin) for name, value, origin in found.lines()]
    if as_json:
        say({name: {"value": value, "from": origin.kind, "name": origin.name} for name, value, origin in rows})
        return
    widths = [max(len(str(row[column])) for row in rows) for column in (0, 1)]
    for name, value, origin in rows:
        shown = "" if value is None else str(value)
        click.echo(f"{name:{widths[0]}}  {shown:{widths[1]}}  {origin}")


def _text(value: object) -> object:
    return str(value) if isinstance(value, Path) else value
