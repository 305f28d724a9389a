"""API keys and their scopes. Keys are off unless the operator sets a file of keys, which is read again at intervals.

A line holds a name, the scopes separated by commas, and the SHA-256 of the key in hex. ``#`` begins a comment. Keys are
long and random (``cazsl keys new`` makes them), so a plain digest cannot be reversed by guessing. A line that is not
valid costs that line only.

An editor may empty a file before it writes it. A key is therefore accepted from the first reading that finds it to the
second one in a row that does not. A file that is missing or holds no valid line is no reading: the keys of the last
good one stay, and the problem is reported.
"""

import hashlib
import logging
import re
import secrets
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Final, Self

from service.errors import ForbiddenError, MissingKeyError, SettingsError
from service.files import read_file, without_mark

KEY_BYTES: Final = 32
READ_INTERVAL_S: Final = 0.5
_NAME: Final = re.compile(r"[A-Za-z0-9._-]{1,64}")
_LINE: Final = re.compile(r"(?P<name>[^ \t]+)[ \t]+(?P<scopes>[^ \t]+)[ \t]+(?P<sha256>[^ \t]+)")
_DIGEST: Final = re.compile(r"[0-9a-f]{64}")
_MOST_PROBLEMS: Final = 10

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
        """Create a grant and its key, which is shown only now.

        Raises:
            SettingsError: the line of the grant could not be read back.
        """
        key = secrets.token_urlsafe(KEY_BYTES)
        grant = cls(name, scopes, digest_of(key.encode()))
        try:
            _parse_line(grant.line())
        except ValueError as error:
            raise SettingsError(f"NAME: a line of keys with it could not be read back: {error}") from error
        return grant, key

    def line(self) -> str:
        """Return the line of the file."""
        return f"{self.name} {','.join(sorted(self.scopes))} {self.sha256.hex()}"


@dataclass(frozen=True)
class KeyFile:
    """File of keys: the grants by digest, a problem for each line that is not valid, and the content."""

    grants: Mapping[bytes, Grant]
    problems: tuple[str, ...]
    content: bytes

    @classmethod
    def parse(cls, content: bytes) -> Self:
        """Parse a file of keys. No line prevents another one from being read."""
        grants: dict[bytes, Grant] = {}
        problems = []
        for number, line in enumerate(without_mark(content).split(b"\n"), start=1):
            try:
                text = line.partition(b"#")[0].decode("ascii", "replace").strip()
                grant = _parse_line(text) if text else None
                if grant is not None and grant.sha256 in grants:
                    raise ValueError(f"the key of {grants[grant.sha256].name} again; remove one of the two lines")
            except ValueError as error:
                problems.append(f"line {number}: {error}")
            else:
                if grant is not None:
                    grants[grant.sha256] = grant
        return cls(grants, tuple(problems), content)

    @classmethod
    def read(cls, path: Path, last: Self | None = None) -> Self:
        """Read a file of keys, once and from one descriptor. Return the last reading if the content is the same.

        To parse ten thousand lines takes 0.1 s, in which other threads wait for the interpreter lock.

        Raises:
            SettingsError: the file cannot be read, or no line of it is valid. The message does not hold its path.
        """
        try:
            content = read_file(path)
        except OSError as error:
            raise SettingsError(f"the file of keys cannot be read: {error.strerror}") from error
        found = last if last is not None and last.content == content else cls.parse(content)
        if found.problems and not found.grants:
            raise SettingsError(f"no line of the file of keys is valid: {found.problems[0]}")
        return found


class Keys:
    """Keys of a file, in its current state.

    Attributes:
        problems: problems of the file, for people who look after the service. They hold no text of the file.
    """

    def __init__(self, path: Path | None) -> None:
        """Read the file for the first time.

        Raises:
            SettingsError: the file is missing, or wrong.
        """
        self._path = path
        self._last = KeyFile({}, (), b"")
        self._accepted: Mapping[bytes, Grant] = {}
        self.problems: tuple[str, ...] = ()
        if path is not None:
            try:
                self._take(KeyFile.read(path))
            except SettingsError as error:
                raise SettingsError(f"CAZSL_KEYS: {path}: {error}; `cazsl keys new NAME` makes a line") from error

    @property
    def wanted(self) -> bool:
        """Return True if keys are required."""
        return self._path is not None

    @property
    def count(self) -> int:
        """Return the number of keys that are accepted."""
        return len(self._accepted)

    def admit(self, authorization: bytes | None, scope: Scope) -> Grant | None:
        """Return the grant of the key in this Authorization header, or None if keys are off.

        The digest of the key is looked up. The time of that tells about digests, from which no key follows.

        Raises:
            MissingKeyError: the header has no key, or an unknown one.
            ForbiddenError: the key lacks the scope.
        """
        if self._path is None:
            return None
        kind, _, key = (authorization or b"").partition(b" ")
        found = self._accepted.get(digest_of(key.strip()))
        if kind.lower() != b"bearer" or found is None:
            raise MissingKeyError
        if scope not in found.scopes:
            raise ForbiddenError(scope)
        return found

    def reread(self) -> None:
        """Read the file again. Called at intervals from a thread: a disk may hang, and the event loop may not."""
        if self._path is None:
            return
        try:
            found = KeyFile.read(self._path, self._last)
        except SettingsError as error:
            self._accepted = self._last.grants
            self._report((f"{error}. The keys of its last good state are accepted.",))
        else:
            self._take(found)

    def _take(self, found: KeyFile) -> None:
        """Accept the keys of a reading, and those of the one before."""
        accepted = {**self._last.grants, **found.grants}
        if accepted != self._accepted:
            logger.info("keys changed", extra={"keys": len(found.grants)})
        self._last, self._accepted = found, accepted
        more = len(found.problems) - _MOST_PROBLEMS
        self._report(
            (
                *found.problems[:_MOST_PROBLEMS],
                *([f"{more} more lines are not valid"] if more > 0 else []),
                *([] if found.grants else ["there is no key in the file, so every request is refused"]),
            )
        )

    def _report(self, problems: tuple[str, ...]) -> None:
        problems = tuple(f"keys: {problem}" for problem in problems)
        if problems != self.problems:
            self.problems = problems
            if problems:
                logger.error("the file of keys has problems", extra={"problems": list(problems)})
            else:
                logger.info("the file of keys has no problem any more")


def digest_of(key: bytes) -> bytes:
    """Return the digest of a key, by which it is known."""
    return hashlib.sha256(key).digest()


def _parse_line(text: str) -> Grant:
    """Parse a line without its comment.

    Raises:
        ValueError: the line is not a name, scopes and a digest. The message does not repeat it.
    """
    found = _LINE.fullmatch(text)
    if found is None:
        raise ValueError("not a name, scopes and the SHA-256 of a key, separated by spaces")
    if not _NAME.fullmatch(found["name"]):
        raise ValueError("a name has 1 to 64 letters, digits, '.', '_' and '-'")
    try:
        scopes = frozenset(Scope(scope) for scope in found["scopes"].split(","))
    except ValueError as error:
        raise ValueError(f"scopes are {' and '.join(Scope)}, separated by a comma without a space") from error
    if not _DIGEST.fullmatch(found["sha256"]):
        raise ValueError("a SHA-256 has 64 hex digits, in lower case")
    return Grant(found["name"], scopes, bytes.fromhex(found["sha256"]))
