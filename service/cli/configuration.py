"""What is in force, and who said so: options of the command line, then the environment, then a file, then defaults.

Nothing is ignored in silence: a name that is no setting, in the environment or in the file, and a value that cannot
be, end the start with one line that names them.
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
from pydantic_settings import EnvSettingsSource, TomlConfigSettingsSource

from service.errors import SettingsError
from service.settings import PREFIX, Settings

CONFIG_NAME: Final = f"{PREFIX}CONFIG"
# Names of ours that are no settings of the service.
OTHER_NAMES: Final = frozenset((CONFIG_NAME, f"{PREFIX}KEY_PASSWORD"))
MASK: Final = "********"
_CREDENTIALS = re.compile(r"(?<=://)[^/@]*@")
_SERVICE_LINK = re.compile(rf"{PREFIX}(SERVICE_(HOST|PORT)|PORT_[0-9]+_(TCP|UDP))")
_LINK_ADVICE: Final = (
    "; Kubernetes sets such names for a Service called cazsl: set enableServiceLinks: false in the pod"
)


@dataclass(frozen=True)
class Origin:
    """Where a value came from."""

    kind: str  # option, environment, file or default
    name: str = ""

    def __str__(self) -> str:
        return f"{self.kind} {self.name}".strip()


@dataclass(frozen=True)
class Configuration:
    """Settings, and for each of them where it came from."""

    settings: Settings
    origins: Mapping[str, Origin]

    def lines(self) -> Iterator[tuple[str, object, Origin]]:
        """Name, value (secrets masked) and origin of every setting."""
        for name, value in self.settings:
            yield name, masked(value), self.origins[name]


def configure(options: Mapping[str, Any], path: Path | None = None) -> Configuration:
    """The settings in force: options that are not None, the environment, and a file, or the one of CAZSL_CONFIG.

    Raises:
        SettingsError: the file cannot be read, a name is unknown, or a value cannot be.
    """
    if path is None and os.environ.get(CONFIG_NAME):
        path = Path(os.environ[CONFIG_NAME])
    _check_environment()
    given: dict[str, Any] = {}
    origins = {name: Origin("default") for name in Settings.model_fields}
    in_file = {} if path is None else _read(path)
    in_environment = EnvSettingsSource(Settings)()
    for kind, values in (("file", in_file), ("environment", in_environment), ("option", options)):
        for name, value in values.items():
            if value is not None:
                given[name] = value
                origins[name] = Origin(kind, _called(kind, name, path))
    try:
        return Configuration(Settings(**given), origins)
    except ValidationError as error:
        raise SettingsError(_first(error, origins)) from error


def masked(value: object) -> object:
    """A value fit to print."""
    if isinstance(value, SecretStr):
        return MASK
    return _CREDENTIALS.sub(f"{MASK}@", value) if isinstance(value, str) else value


def _called(kind: str, name: str, path: Path | None) -> str:
    """How whoever set it calls it."""
    if kind == "environment":
        return PREFIX + name.upper()
    return f"--{name.replace('_', '-')}" if kind == "option" else str(path)


def _check_environment() -> None:
    known = {PREFIX + name.upper() for name in Settings.model_fields} | OTHER_NAMES
    for name in sorted(os.environ):
        if name.upper().startswith(PREFIX) and name.upper() not in known:
            advice = _LINK_ADVICE if _SERVICE_LINK.match(name) else _nearest(name, known)
            raise SettingsError(f"{name}: received a name that is no setting; `cazsl config` lists them{advice}")


def _read(path: Path) -> dict[str, Any]:
    """The settings in a file of TOML."""
    if not path.is_file():
        raise SettingsError(f"{path}: received a name of no file; accepted is a file of TOML with settings")
    try:
        found = TomlConfigSettingsSource(Settings, path)()
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise SettingsError(f"{path}: cannot be read as TOML: {error}") from error
    for name in found:
        if name not in Settings.model_fields:
            advice = _nearest(name, set(Settings.model_fields))
            raise SettingsError(
                f"{path}: {name}: received a name that is no setting; `cazsl config` lists them{advice}"
            )
    return found


def _nearest(name: str, known: set[str]) -> str:
    near = difflib.get_close_matches(name, known, 1)
    return f"; is {near[0]} meant?" if near else ""


def _first(error: ValidationError, origins: Mapping[str, Origin]) -> str:
    """The first fault in one line; a value that may be secret is not repeated."""
    fault = error.errors(include_url=False)[0]
    name = str(fault["loc"][0])
    origin = origins[name]
    where = f"{origin.name}: {name}" if origin.kind == "file" else origin.name
    field = Settings.model_fields[name]
    given = fault.get("input")
    link = _LINK_ADVICE if isinstance(given, str) and given.startswith("tcp://") else ""
    received = "" if isinstance(given, SecretStr) else f" (received {str(masked(given))[:80]!r})"
    return f"{where}: {fault['msg']}{received}: {field.description}{link}"
