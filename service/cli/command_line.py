"""The form of all commands, of the trainer's too: groups, options and arguments, and the end of a command.

A command ends in success, or in one line on standard error and an exit status (``service.cli.terminal`` lists them).
No input leads to a traceback: not a file that is a pipe, not a closed output, not a name that is not UTF-8.
"""

import contextlib
import functools
import os
import stat
import sys
import traceback
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, ParamSpec, TypeVar

import click
from click.core import ParameterSource

from service.cli.configuration import CONFIG_NAME, configure
from service.cli.terminal import FAILED, echo, echo_lines, open_streams, print_json, release_streams, status_of
from service.errors import CazslError
from service.files import check_regular
from service.settings import NOT_TEXT, PREFIX

P = ParamSpec("P")
F = TypeVar("F", bound=Callable[..., Any])
HELP: Final = {"help_option_names": ["-h", "--help"], "max_content_width": 110}
_LONGEST_LINE: Final = 2000
_DEBUG: Final = f"{PREFIX}LOG_LEVEL"


class CommandLine(click.Group):
    """Group of commands whose faults are one line each."""

    def main(
        self,
        args: Sequence[str] | None = None,
        prog_name: str | None = None,
        complete_var: str | None = None,
        standalone_mode: bool = True,
        **extra: Any,
    ) -> Any:
        """Run a command and exit with its status."""
        if not standalone_mode:
            return super().main(args, prog_name, complete_var, standalone_mode=False, **extra)
        open_streams()
        try:
            found = super().main(args, prog_name, complete_var, standalone_mode=False, **extra)
            status = found if isinstance(found, int) else 0
        except SystemExit as ended:
            status = ended.code if isinstance(ended.code, int) else FAILED
        except click.exceptions.NoArgsIsHelpError as error:
            status = error.exit_code
            _try(echo_lines, error.format_message())
        except BaseException as error:  # the outermost ring of the process
            if os.environ.get(_DEBUG) == "DEBUG":
                traceback.print_exc()
            status, text = _fault(error)
            _try(echo, text if len(text) <= _LONGEST_LINE else f"{text[:_LONGEST_LINE]} ...")
        sys.exit(status if release_streams() else status or FAILED)


def _try(write: Callable[[str, bool], None], text: str) -> None:
    """Write a text to standard error, unless that is closed or full too."""
    with contextlib.suppress(click.ClickException):
        write(text, True)


def _fault(error: BaseException) -> tuple[int, str]:
    """Return the exit status and the line for an error that ended a command."""
    if isinstance(error, click.ClickException):
        context = getattr(error, "ctx", None)
        advice = f" See: {context.command_path} -h" if isinstance(context, click.Context) else ""
        return error.exit_code, f"Error: {error.format_message()}{advice}"
    if isinstance(error, click.Abort | KeyboardInterrupt | EOFError):
        return FAILED, "Aborted!"
    if isinstance(error, CazslError):
        return status_of(error), f"Error: {error}"
    if isinstance(error, OSError):
        reason = error.strerror or str(error) or type(error).__name__
        if error.filename is None:
            return FAILED, f"Error: {reason}"
        return FAILED, f"Error: {_name(error.filename)}: {reason}; fix that or name another path"
    if isinstance(error, RecursionError):
        return FAILED, "Error: the input is nested too deep"
    if isinstance(error, MemoryError):
        return FAILED, "Error: there is not enough memory"
    return FAILED, f"Error: unexpected {type(error).__name__}: {error}. {_DEBUG}=DEBUG shows where. Please report it."


def _name(path: object) -> str:
    return os.fsdecode(path) if isinstance(path, bytes | str | os.PathLike) else str(path)


class Option(click.Option):
    """Option that is not set if it is given without text, as by ``--out "$OUT"`` in a script."""

    def consume_value(self, ctx: click.Context, opts: Mapping[str, Any]) -> tuple[Any, ParameterSource]:
        """Return the value and its source."""
        given = {name: value for name, value in opts.items() if name != self.name or not _is_blank(value)}
        return super().consume_value(ctx, given)

    def resolve_envvar_value(self, ctx: click.Context) -> str | None:
        """Return the value of the environment variable, or None if it has no text."""
        return (super().resolve_envvar_value(ctx) or "").strip() or None

    def type_cast_value(self, ctx: click.Context, value: Any) -> Any:
        """Return the value in the type of the option."""
        return _clean(super().type_cast_value(ctx, value), ctx, self)


class Argument(click.Argument):
    """Argument that is refused if it is given without text."""

    def consume_value(self, ctx: click.Context, opts: Mapping[str, Any]) -> tuple[Any, ParameterSource]:
        """Return the value and its source."""
        if _is_blank(opts.get(self.name or "")):
            raise click.BadParameter("received an empty text.", ctx, self)
        return super().consume_value(ctx, opts)

    def type_cast_value(self, ctx: click.Context, value: Any) -> Any:
        """Return the value in the type of the argument."""
        return _clean(super().type_cast_value(ctx, value), ctx, self)


def option(*names: str, **attributes: Any) -> Callable[[F], F]:
    """Return the decorator that adds an ``Option``."""
    return click.option(*names, cls=Option, **attributes)


def argument(*names: str, **attributes: Any) -> Callable[[F], F]:
    """Return the decorator that adds an ``Argument``."""
    return click.argument(*names, cls=Argument, **attributes)


class FilePath(click.Path):
    """Path of a file: to read, or to write. If it exists, it is a regular file."""

    def __init__(self, exists: bool = False) -> None:
        super().__init__(exists=exists, path_type=Path)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the path, or refuse a folder, a pipe and a device."""
        path = Path(os.fsdecode(super().convert(value, param, ctx)))
        try:
            check_regular(path, path.stat().st_mode)
        except FileNotFoundError:
            return path
        except OSError as error:
            self.fail(f"{value}: {error.strerror}.", param, ctx)
        return path


class FolderPath(click.Path):
    """Path of a folder: to read, or to write. If it exists, it is a folder."""

    def __init__(self) -> None:
        super().__init__(path_type=Path)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the path, or refuse any file."""
        path = Path(os.fsdecode(super().convert(value, param, ctx)))
        try:
            is_folder = stat.S_ISDIR(path.stat().st_mode)
        except OSError:  # missing, or out of reach: the command says so when it needs the folder
            return path
        if not is_folder:
            self.fail(f"{value} is a file, not a folder.", param, ctx)
        return path


FILE: Final = FilePath()
FILE_THAT_EXISTS: Final = FilePath(exists=True)
FOLDER: Final = FolderPath()
ANY_PATH: Final = click.Path(path_type=Path)


def _is_blank(value: object) -> bool:
    return isinstance(value, str) and not value.strip()


def _clean(value: Any, ctx: click.Context, parameter: click.Parameter) -> Any:
    """Return a text without white space at its ends. A path stays as it is: argv has it from the shell, to the byte."""
    if isinstance(value, tuple | list):
        return type(value)(_clean(part, ctx, parameter) for part in value)
    if not isinstance(value, str):
        return value
    if NOT_TEXT.search(value.strip()):
        raise click.BadParameter("has a control character, or is not UTF-8. Send printable text.", ctx, parameter)
    return value.strip()


def _default_registry() -> str:
    """Return the registry of the settings file, for commands without --registry and CAZSL_REGISTRY."""
    return configure({}).settings.registry if os.environ.get(CONFIG_NAME, "").strip() else "models"


registry_option = option(
    "--registry",
    envvar="CAZSL_REGISTRY",
    default=_default_registry,
    show_default="models",
    help="Registry of models: a folder, or s3://bucket/prefix.",
)
json_option = option("--json", "as_json", is_flag=True, help="Print one JSON document instead of text.")


def errors_as_one_line(command: Callable[P, None]) -> Callable[P, None]:
    """Print a ``CazslError`` of a command as one line, or as one JSON document, and exit with its status."""

    @functools.wraps(command)
    def run(*args: P.args, **kwargs: P.kwargs) -> None:
        try:
            command(*args, **kwargs)
        except CazslError as error:
            if not kwargs.get("as_json"):
                raise
            print_json({"code": error.code, "detail": str(error)})
            sys.exit(status_of(error))

    return run
