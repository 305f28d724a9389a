"""Settings with their sources: options of the command line, then the environment, then a file, then defaults.

An unknown name in the environment or in the file, or an invalid value, ends the command with one line that names it.
"""

import difflib
import os
import re
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from pydantic import SecretStr, ValidationError
from pydantic_settings import EnvSettingsSource

from service.errors import SettingsError
from service.files import read_text
from service.settings import PREFIX, Settings, is_set

CONFIG_NAME: Final = f"{PREFIX}CONFIG"
# Environment variables of this project that are not settings of the service.
OTHER_NAMES: Final = frozenset((CONFIG_NAME, f"{PREFIX}KEY_PASSWORD"))
MASK: Final = "********"
_CREDENTIALS: Final = re.compile(r"(?<=://)[^/@]*@")
_SERVICE_LINK: Final = re.compile(rf"{PREFIX}(SERVICE_(HOST|PORT)|PORT_[0-9]+_(TCP|UDP))")
_LINK_ADVICE: Final = (
    " Kubernetes sets such names for a Service called cazsl: set enableServiceLinks: false in the pod."
)


@dataclass(frozen=True)
class Origin:
    """Source of a value: an option, the environment, a file or the default."""

    kind: str  # option, environment, file or default
    name: str = ""

    def __str__(self) -> str:
        return f"{self.kind} {self.name}".strip()


@dataclass(frozen=True)
class Configuration:
    """Settings with the source of each."""

    settings: Settings
    origins: Mapping[str, Origin]

    def lines(self) -> Iterator[tuple[str, object, Origin]]:
        """Yield name, value (secrets masked) and source of every setting."""
        for name, value in self.settings:
            yield name, masked(value), self.origins[name]


def configure(options: Mapping[str, Any], path: Path | None = None) -> Configuration:
    """Merge options, the environment, and a file. Values without text do not count. CAZSL_CONFIG names a default file.

    Raises:
        SettingsError: the file cannot be read, a name is unknown, or a value is invalid.
    """
    named = os.environ.get(CONFIG_NAME, "").strip()
    path = Path(named) if path is None and named else path
    _check_environment()
    given: dict[str, Any] = {}
    origins = {name: Origin("default") for name in Settings.model_fields}
    in_file = {} if path is None else _read(path)
    in_environment = EnvSettingsSource(Settings)()
    for kind, values in (("file", in_file), ("environment", in_environment), ("option", options)):
        for name, value in values.items():
            if is_set(value):
                given[name] = value
                origins[name] = Origin(kind, _source_name(kind, name, path))
    try:
        return Configuration(Settings(**given), origins)
    except ValidationError as error:
        raise SettingsError(_first_fault(error, origins)) from error


def masked(value: object) -> object:
    """Return a value without secrets, for output."""
    if isinstance(value, SecretStr):
        return MASK
    return _CREDENTIALS.sub(f"{MASK}@", value) if isinstance(value, str) else value


def _source_name(kind: str, name: str, path: Path | None) -> str:
    """Return the name of a setting as it was written: an environment variable, an option, or the file."""
    if kind == "environment":
        return PREFIX + name.upper()
    return f"--{name.replace('_', '-')}" if kind == "option" else str(path)


def _check_environment() -> None:
    known = {PREFIX + name.upper() for name in Settings.model_fields} | OTHER_NAMES
    for name in sorted(os.environ):
        if name.upper().startswith(PREFIX) and name.upper() not in known and is_set(os.environ[name]):
            advice = _LINK_ADVICE if _SERVICE_LINK.match(name) else _nearest(name, known)
            raise SettingsError(f"{name}: unknown setting. `cazsl config` lists all settings.{advice}")


def _read(path: Path) -> dict[str, Any]:
    """Read the settings of a TOML file."""
    try:
        found = tomllib.loads(read_text(path))
    except FileNotFoundError as error:
        raise SettingsError(f"{path}: there is no such file. Give a TOML file of settings.") from error
    except OSError as error:
        raise SettingsError(f"{path}: cannot be read as TOML: {error.strerror}.") from error
    except ValueError as error:  # not TOML, or a number of thousands of digits
        raise SettingsError(f"{path}: cannot be read as TOML: {error}.") from error
    except RecursionError as error:
        raise SettingsError(f"{path}: is nested too deep. A file of settings has names and values only.") from error
    for name in found:
        if name not in Settings.model_fields:
            advice = _nearest(name, set(Settings.model_fields))
            raise SettingsError(f"{path}: {name}: unknown setting. `cazsl config` lists all settings.{advice}")
    return found


def _nearest(name: str, known: set[str]) -> str:
    near = difflib.get_close_matches(name, known, 1)
    return f" Did you mean {near[0]}?" if near else ""


def _first_fault(error: ValidationError, origins: Mapping[str, Origin]) -> str:
    """Describe the first fault in one line, without the value of a secret."""
    fault = error.errors(include_url=False)[0]
    name = str(fault["loc"][0])
    origin = origins[name]
    where = f"{origin.name}: {name}" if origin.kind == "file" else origin.name
    field = Settings.model_fields[name]
    given = fault.get("input")
    link = _LINK_ADVICE if isinstance(given, str) and given.startswith("tcp://") else ""
    received = "" if isinstance(given, SecretStr) else f" (received {str(masked(given))[:80]!r})"
    wrong = fault["msg"].removeprefix("Value error, ")
    return f"{where}: {wrong}{received}. Meaning: {field.description}{link}"
