"""API keys and their scopes. Keys are off unless the operator sets a file of keys, which is read again when it changes.

A line holds a name, the scopes separated by commas, and the SHA-256 of the key in hex. ``#`` begins a comment. Keys are
long and random (``cazsl keys new`` makes them), so a plain digest cannot be reversed by guessing. If the file
cannot be read, or a line is not valid, no key is accepted.
"""

import hashlib
import hmac
import logging
import re
import secrets
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Final, Self

from service.errors import ForbiddenError, MissingKeyError

KEY_BYTES: Final = 32
_LINE = re.compile(r"(?P<name>[A-Za-z0-9._-]{1,64})\s+(?P<scopes>[a-z,]{1,64})\s+(?P<sha256>[0-9a-f]{64})")
_LARGEST_FILE: Final = 1 << 20

logger = logging.getLogger(__name__)


class Scope(StrEnum):
    """The scopes that a key may have."""

    PREDICT = "predict"
    METRICS = "metrics"


@dataclass(frozen=True)
class Grant:
    """A key, by its name, its scopes and its digest."""

    name: str
    scopes: frozenset[Scope]
    sha256: bytes

    @classmethod
    def new(cls, name: str, scopes: frozenset[Scope]) -> tuple[Self, str]:
        """Create a grant and its key, which is shown only now."""
        key = secrets.token_urlsafe(KEY_BYTES)
        return cls(name, scopes, _digest(key.encode())), key

    def line(self) -> str:
        """Return the line of the file."""
        return f"{self.name} {','.join(sorted(self.scopes))} {self.sha256.hex()}"


class Keys:
    """Keys of a file, in its current state."""

    def __init__(self, path: Path | None) -> None:
        self._path = path
        self._last_status: object = None
        self._grants: tuple[Grant, ...] = ()

    @property
    def wanted(self) -> bool:
        """Return True if keys are required."""
        return self._path is not None

    def admit(self, authorization: bytes | None, scope: Scope) -> Grant | None:
        """Return the grant of the key in this Authorization header, or None if keys are off.

        Raises:
            MissingKeyError: the header has no key, or an unknown one.
            ForbiddenError: the key lacks the scope.
        """
        if self._path is None:
            return None
        self._reread(self._path)
        kind, _, key = (authorization or b"").partition(b" ")
        digest = _digest(key.strip())
        found = None
        for grant in self._grants:  # compare all, each in constant time: the duration must not depend on the key
            if hmac.compare_digest(grant.sha256, digest):
                found = grant
        if kind.lower() != b"bearer" or found is None:
            raise MissingKeyError
        if scope not in found.scopes:
            raise ForbiddenError(scope)
        return found

    def _reread(self, path: Path) -> None:
        """Read the file again if it has changed. If it cannot be read, no key is accepted."""
        try:
            status = path.stat()
            current = (status.st_mtime_ns, status.st_size, status.st_ino)
            if current == self._last_status:
                return
            self._last_status = current
            self._grants = parse(path.read_text(encoding="utf-8") if status.st_size <= _LARGEST_FILE else "too large")
            logger.info("keys read", extra={"keys": len(self._grants)})
        except (OSError, ValueError) as error:
            if self._grants or not isinstance(error, OSError):
                logger.error("keys cannot be read: no key is accepted", extra={"cause": str(error)})
            self._grants = ()
            if isinstance(error, OSError):
                self._last_status = None  # the file may come back unchanged


def parse(text: str) -> tuple[Grant, ...]:
    """Parse a file of keys.

    Raises:
        ValueError: a line is not valid. The message names the line.
    """
    grants = []
    for number, line in enumerate(text.splitlines(), start=1):
        content = line.partition("#")[0].strip()
        if not content:
            continue
        found = _LINE.fullmatch(content)
        try:
            if found is None:
                raise ValueError("not a name, scopes and a SHA-256")
            scopes = frozenset(Scope(scope) for scope in found["scopes"].split(","))
        except ValueError as error:
            raise ValueError(f"line {number}: {error}") from error
        grants.append(Grant(found["name"], scopes, bytes.fromhex(found["sha256"])))
    return tuple(grants)


def _digest(key: bytes) -> bytes:
    return hashlib.sha256(key).digest()
