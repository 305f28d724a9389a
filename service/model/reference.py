"""The names that models go by: names, aliases, versions, references. The one grammar of all of them."""

import re
from dataclasses import dataclass
from typing import Final, Self

from service.errors import InvalidRequestError

DEFAULT_ALIAS: Final = "champion"
_NAME = re.compile(r"[a-z0-9][a-z0-9_-]{0,63}")
_VERSION = re.compile(r"[1-9][0-9]{0,8}")
REFERENCE_SYNTAX: Final = "name, name@alias or name@version, of lower-case letters, digits, '-' and '_'"


def is_name(text: str) -> bool:
    """Whether this may name a model or an alias; a number is no alias."""
    return _NAME.fullmatch(text) is not None


def is_alias(text: str) -> bool:
    """Whether this may name an alias: a name that cannot be taken for a version."""
    return is_name(text) and not text.isdigit()


def parse_version(text: str) -> int | None:
    """A positive integer without leading zeros, or None."""
    return int(text) if _VERSION.fullmatch(text) else None


@dataclass(frozen=True, slots=True)
class ModelReference:
    """How a caller names a model: ``name``, ``name@alias`` or ``name@version``; ``name`` alone means its champion."""

    name: str
    alias: str | None
    version: int | None

    @classmethod
    def parse(cls, text: str, where: str = "model") -> Self:
        """Read a reference.

        Raises:
            InvalidRequestError: it is not one; the text is not repeated.
        """
        name, at, rest = text.partition("@")
        version = parse_version(rest)
        if is_name(name) and (not at or version is not None or is_alias(rest)):
            return cls(name, None if version is not None else (rest or DEFAULT_ALIAS), version)
        raise InvalidRequestError.at(where, f"a text of {len(text)} characters", REFERENCE_SYNTAX)

    def __str__(self) -> str:
        return f"{self.name}@{self.alias if self.version is None else self.version}"
