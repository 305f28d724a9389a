"""``cazsl config``: print every setting with its source. The options are shared with ``cazsl serve``."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import click

from service.cli.command_line import FILE, errors_as_one_line, json_option, option
from service.cli.configuration import Configuration, configure
from service.cli.terminal import echo, print_json

_OPTIONS: Final = (
    option("--host", help="Address to listen on. [default: 127.0.0.1]"),
    option("--port", type=int, help="Port to listen on. 0 picks a free port. [default: 8000]"),
    option("--registry", help="Registry of models: a folder, or s3://bucket/prefix. [default: models]"),
    option(
        "--config",
        "path",
        type=FILE,
        help="TOML file of settings, such as port = 9000. [default: the file that CAZSL_CONFIG names]",
    ),
)


def settings_options(command: Callable[..., None]) -> Callable[..., None]:
    """Add the options of a command that takes settings."""
    for add in reversed(_OPTIONS):
        command = add(command)
    return command


def configured(options: dict[str, Any]) -> Configuration:
    """Return the configuration that results from the options of a command.

    Raises:
        SettingsError: a setting is unknown or invalid. The message is one line that names it.
    """
    path: Path | None = options.pop("path")
    return configure(options, path)


@click.command("config")
@settings_options
@json_option
@errors_as_one_line
def config(as_json: bool, **options: Any) -> None:
    """Print every setting with its value and source. Secrets are masked. The service is not started.

    \b
    cazsl config --port 9000
    CAZSL_CONFIG=/etc/cazsl/cazsl.toml cazsl config --json
    """
    found = configured(options)
    rows = [(name, _text(value), origin) for name, value, origin in found.lines()]
    if as_json:
        print_json({name: {"value": value, "from": origin.kind, "name": origin.name} for name, value, origin in rows})
        return
    widths = [max(len(str(row[column])) for row in rows) for column in (0, 1)]
    for name, value, origin in rows:
        shown = "" if value is None else str(value)
        echo(f"{name:{widths[0]}}  {shown:{widths[1]}}  {origin}")


def _text(value: object) -> object:
    return str(value) if isinstance(value, Path) else value
