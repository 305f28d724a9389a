"""Events of a model's history and the state that they lead to: publish, alias move, removal, repair.

An event is one line of JSON: ``time`` (UTC, ISO 8601), ``who``, ``what``, ``from``, ``to``, ``reason``, ``number`` of
the line, and ``previous``: the sha256 of the line before it. ``service.storage.history`` chains them.

A version or an alias that disappeared without a writer's order is recorded once it is noticed (``Event.is_absence``).
"""

import getpass
import json
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from typing import Any, Final, Self, TypeVar

from service.errors import ConflictError
from service.model.strict_json import check_integer, check_text, read_json

MAX_LINE_BYTES: Final = 64 << 10
MAX_USER: Final = 200  # characters of a user's name
PUBLISH: Final = "publish"
REMOVE: Final = "remove"
REPAIR: Final = "repair"
SIGN: Final = "sign"
VANISH: Final = "vanish"
ALIASES: Final = "aliases"
Value = TypeVar("Value")
_ALIAS: Final = "alias "
UNRECORDED: Final = "recorded afterwards: a writer was interrupted, or files were changed by hand"
INTERRUPTED: Final = "recorded afterwards: the writer was interrupted"


@dataclass(frozen=True)
class ModelState:
    """Visible state of a model: its versions, the version that each alias names, and the removed numbers.

    ``faults`` has the parts that could not be read, by their place below the model, with the cause in words. Such a
    part is unknown, which is not the same as absent.
    """

    versions: frozenset[int] = frozenset()
    aliases: Mapping[str, int] = field(default_factory=dict)
    removed: frozenset[int] = frozenset()
    faults: Mapping[str, str] = field(default_factory=dict)

    def is_unknown(self, alias: str) -> bool:
        """Return whether an alias may exist although ``aliases`` lacks it, because its file could not be read."""
        return not {ALIASES, f"{ALIASES}/{alias}"}.isdisjoint(self.faults)

    def naming(self, version: int) -> list[str]:
        """Return the aliases that name a version, and those that cannot be read and may name it."""
        unread = [f"{place} (unreadable)" for place in self.faults if place.startswith(ALIASES)]
        return sorted([*(alias for alias, to in self.aliases.items() if to == version), *unread])

    @property
    def next_version(self) -> int:
        """The smallest number above every number that was ever used."""
        return max(self.versions | self.removed, default=0) + 1

    def free_number(self, number: int | None) -> int:
        """Return ``number`` if it was never used. None returns the next version number.

        Raises:
            ConflictError: the number was used.
        """
        if number is None:
            return self.next_version
        if number in self.versions:
            raise ConflictError(f"version {number} exists already; choose another number")
        if number in self.removed:
            raise ConflictError(f"version {number} was removed, and its number is never used again; choose another")
        return number

    def after(self, event: "Event") -> "ModelState":
        """Return the state after an event."""
        target = frozenset({event.to} if event.to is not None else ())
        gone = frozenset({event.before} if event.before is not None else ())
        if event.what == PUBLISH:
            return replace(self, versions=self.versions | target, removed=self.removed - target)
        if event.what in (REMOVE, VANISH):
            return replace(self, versions=self.versions - gone, removed=self.removed | gone)
        if event.alias is not None:
            others = {alias: version for alias, version in self.aliases.items() if alias != event.alias}
            return replace(self, aliases=others if event.to is None else {**others, event.alias: event.to})
        return self


@dataclass(frozen=True)
class Event:
    """One change of a model, or one repair of its history. ``before`` is written as ``from``."""

    what: str
    before: int | None
    to: int | None
    time: str = ""
    who: str = ""
    reason: str | None = None
    manifest: str | None = None  # sha256 of the manifest that was published
    previous: str | None = None  # None only on lines that were written before chains existed
    number: int | None = None  # None only on lines that were written before heads existed

    @property
    def alias(self) -> str | None:
        """The alias that moved, or None for other events."""
        return self.what.removeprefix(_ALIAS) if self.what.startswith(_ALIAS) else None

    @property
    def is_absence(self) -> bool:
        """Whether something had disappeared and no writer had removed it."""
        return self.what == VANISH or (self.alias is not None and self.to is None and self.reason == UNRECORDED)

    @classmethod
    def alias_move(cls, alias: str, before: int | None, to: int | None, reason: str | None = None) -> Self:
        """Create the event of an alias that moves. None for ``to`` drops the alias."""
        return cls(f"{_ALIAS}{alias}", before, to, reason=reason)

    def stamped(self, who: str, previous: str, now: datetime | None = None, number: int | None = None) -> Self:
        """Return the event with its time, its user, the digest of the line before it, and the number of its line."""
        time = (now or datetime.now(UTC)).isoformat(timespec="seconds")
        return replace(self, time=time, who=who, previous=previous, number=number)

    def render(self) -> bytes:
        """Render the event as one line of JSON."""
        document = {
            "time": self.time,
            "who": self.who,
            "what": self.what,
            "from": self.before,
            "to": self.to,
            "reason": self.reason,
            "manifest": self.manifest,
            "number": self.number,
            "previous": self.previous,
        }
        return (json.dumps({key: value for key, value in document.items() if _wanted(key, value)}) + "\n").encode()

    @classmethod
    def parse(cls, line: bytes) -> Self | None:
        """Parse a line. Return None if it is not an event."""
        try:
            document = read_json(line, MAX_LINE_BYTES)
            what, time, who = (_text(document[key]) for key in ("what", "time", "who"))
            reason, manifest, previous = (_optional(_text, document, key) for key in ("reason", "manifest", "previous"))
            before, to, number = (_optional(_number, document, key) for key in ("from", "to", "number"))
        except (ValueError, TypeError, KeyError, AttributeError):
            return None
        return cls(what, before, to, time, who, reason, manifest, previous, number)

    def as_document(self) -> dict[str, Any]:
        """Return the JSON document of the event."""
        document: dict[str, Any] = json.loads(self.render())
        return document


def unrecorded(recorded: ModelState, actual: ModelState) -> Sequence[Event]:
    """Return the events that lead from the recorded state to the actual one."""
    return tuple(replace(event, reason=UNRECORDED) for event in _differences(recorded, actual))


def _differences(recorded: ModelState, actual: ModelState) -> Iterable[Event]:
    for version in sorted(actual.versions - recorded.versions):
        yield Event(PUBLISH, None, version)
    for alias in sorted(actual.aliases.keys() | recorded.aliases.keys()):
        before, to = recorded.aliases.get(alias), actual.aliases.get(alias)
        if before != to and not actual.is_unknown(alias):
            yield Event.alias_move(alias, before, to)
    for version in sorted(recorded.versions - actual.versions):
        yield Event(REMOVE if version in actual.removed else VANISH, version, None)
    for version in sorted(actual.removed - recorded.removed - recorded.versions - actual.versions):
        yield Event(REMOVE, version, None)


def _text(value: object) -> str:
    """Return a text. Old lines may hold line breaks: commands escape them."""
    if not isinstance(value, str):
        raise TypeError("not a text")
    return value


def _number(value: object) -> int:
    return check_integer(value, least=1)


def _optional(read: Callable[[object], Value], document: Mapping[str, object], key: str) -> Value | None:
    """Read a value that may be missing or null."""
    return None if document.get(key) is None else read(document[key])


def _wanted(key: str, value: object) -> bool:
    return value is not None or key in ("from", "to")


def current_user() -> str:
    """Return the name of the user that runs this process, or the number if it has no name."""
    try:
        return check_text(getpass.getuser(), MAX_USER)
    except (KeyError, OSError, ValueError):  # a container's user without an entry in passwd
        return str(os.getuid())
