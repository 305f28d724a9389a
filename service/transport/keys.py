"""API keys: who may ask for what. Off unless the operator names a file of keys; re-read when that file changes.

One key a line: a name, its scopes with commas between, and the SHA-256 of the key in hex; ``#`` begins a comment.
The keys themselves are long and random (``cazsl keys new`` makes them), so a plain digest is enough to keep them:
there is nothing to guess. A file that cannot be read, or a line that is none, opens nothing.
"""

import hashlib
import hmac
import logging
import re
import secrets
from collections.abc import Iterable
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
    """What a key may cover."""

    PREDICT = "predict"
    METRICS = "metrics"


@dataclass(frozen=True)
class Grant:
    """What one key opens."""

    name: str
    scopes: frozenset[Scope]
    sha256: bytes

    @classmethod
    def new(cls, name: str, scopes: frozenset[Scope]) -> tuple[Self, str]:
        """A new grant, and its key: the only time that it is seen."""
        key = secrets.token_urlsafe(KEY_BYTES)
        return cls(name, scopes, _digest(key.encode())), key

    def line(self) -> str:
        """How the file has it."""
        return f"{self.name} {','.join(sorted(self.scopes))} {self.sha256.hex()}"


class Keys:
    """The grants of a file, as it is now."""

    def __init__(self, path: Path | None) -> None:
        self._path = path
        self._seen: object = None
        self._grants: tuple[Grant, ...] = ()

    @property
    def wanted(self) -> bool:
        """Whether a key is needed at all."""
        return self._path is not None

    def admit(self, authorization: bytes | None, scope: Scope) -> None:
        """Let a request pass, or not.

        Raises:
            MissingKeyError: it has no key, or none that is known.
            ForbiddenError: its key does not cover the scope.
        """
        if self._path is None:
            return
        self._reread(self._path)
        kind, _, key = (authorization or b"").partition(b" ")
        digest = _digest(key.strip())
        found = None
        for grant in self._grants:  # all of them, whatever is found: how long it takes tells nothing
            if hmac.compare_digest(grant.sha256, digest):
                found = grant
        if kind.lower() != b"bearer" or found is None:
            raise MissingKeyError
        if scope not in found.scopes:
            raise ForbiddenError(scope)

    def _reread(self, path: Path) -> None:
        """Read the file again when it is another one; when it cannot be read, nothing is open."""
        try:
            status = path.stat()
            seen = (status.st_mtime_ns, status.st_size, status.st_ino)
            if seen == self._seen:
                return
            self._seen = seen
            self._grants = parse(path.read_text(encoding="utf-8") if status.st_size <= _LARGEST_FILE else "too large")
            logger.info("keys read", extra={"keys": len(self._grants)})
        except (OSError, ValueError) as error:
            if self._grants or not isinstance(error, OSError):
                logger.error("keys cannot be read: nothing is open", extra={"cause": str(error)})
            self._grants = ()
            if isinstance(error, OSError):
                self._seen = None  # it may come back as it was


def parse(text: str) -> tuple[Grant, ...]:
    """The grants of a file.

    Raises:
        ValueError: a line is none; says which.
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


def authorization_of(headers: Iterable[tuple[bytes, bytes]]) -> bytes | None:
    """The Authorization header of a request, as ASGI has it."""
    return next((value for name, value in headers if name == b"authorization"), None)


def _digest(key: bytes) -> bytes:
    return hashlib.sha256(key).digest()
