"""Grammar of names: models, aliases, versions, and references to them. No other module has a grammar of its own."""

import re
from dataclasses import dataclass
from typing import Final, Self

from service.errors import InvalidRequestError

DEFAULT_ALIAS: Final = "champion"
NAME_PATTERN: Final = "[a-z0-9][a-z0-9_-]{0,63}"
ALIAS_PATTERN: Final = "[a-z][a-z0-9_-]{0,63}"  # for documents: it leaves out aliases that begin with a digit
VERSION_PATTERN: Final = "[1-9][0-9]{0,8}"
MAX_VERSION: Final = 999_999_999
_NAME = re.compile(NAME_PATTERN)
_VERSION = re.compile(VERSION_PATTERN)
REFERENCE_SYNTAX: Final = "name, name@alias or name@version, of lower-case letters, digits, '-' and '_'"


def is_name(text: str) -> bool:
    """Return whether a text may name a model."""
    return _NAME.fullmatch(text) is not None


def is_alias(text: str) -> bool:
    """Return whether a text may name an alias: a name that is not a number, and so not a version."""
    return is_name(text) and not text.isdigit()


def parse_version(text: str) -> int | None:
    """Return the version that a text denotes: a positive integer without leading zeros. None for any other text."""
    return int(text) if _VERSION.fullmatch(text) else None


@dataclass(frozen=True, slots=True)
class ModelReference:
    """A reference to a model: ``name``, ``name@alias`` or ``name@version``. ``name`` alone names its champion."""

    name: str
    alias: str | None
    version: int | None

    @classmethod
    def parse(cls, text: str, where: str = "model") -> Self:
        """Parse a reference.

        Raises:
            InvalidRequestError: the text is not a reference. The message does not repeat it.
        """
        name, at, rest = text.partition("@")
        version = parse_version(rest)
        if is_name(name) and (not at or version is not None or is_alias(rest)):
            return cls(name, None if version is not None else (rest or DEFAULT_ALIAS), version)
        raise InvalidRequestError.at(where, f"a text of {len(text)} characters", REFERENCE_SYNTAX)

    def __str__(self) -> str:
        return f"{self.name}@{self.alias if self.version is None else self.version}"
