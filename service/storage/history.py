"""History of a model as a chain of lines: publish, alias move, removal. This module reads and writes no files.

``history.jsonl`` holds one JSON object per line: ``time`` (UTC, ISO 8601), ``who``, ``what``, ``from``, ``to``,
``reason``, and ``previous``: the sha256 of the line before it, newline included. Changing, removing or inserting a line
breaks the chain at that place. The first line with ``previous`` covers everything before it, so a history that began
without a chain continues as one.

A writer that is killed leaves at most a torn last line, or a change without a line. The next writer cuts off the torn
line or adds the missing one, and records that it did.
"""

import getpass
import hashlib
import json
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from typing import Any, Final, Self

from service.errors import ConflictError

PUBLISH: Final = "publish"
REMOVE: Final = "remove"
REPAIR: Final = "repair"
SIGN: Final = "sign"
VANISH: Final = "vanish"
_ALIAS: Final = "alias "
_NO_HASH: Final = hashlib.sha256().hexdigest()
UNRECORDED: Final = "recorded afterwards: a writer was interrupted, or files were changed by hand"


@dataclass(frozen=True)
class ModelState:
    """Visible state of a model: its versions, the version that each alias names, and the removed numbers."""

    versions: frozenset[int] = frozenset()
    aliases: Mapping[str, int] = field(default_factory=dict)
    removed: frozenset[int] = frozenset()

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

    @property
    def alias(self) -> str | None:
        """The alias that moved, or None for other events."""
        return self.what.removeprefix(_ALIAS) if self.what.startswith(_ALIAS) else None

    @classmethod
    def alias_move(cls, alias: str, before: int | None, to: int | None, reason: str | None = None) -> Self:
        """Create the event of an alias that moves. None for ``to`` drops the alias."""
        return cls(f"{_ALIAS}{alias}", before, to, reason=reason)

    def stamped(self, who: str, previous: str, now: datetime | None = None) -> Self:
        """Return the event with its time, its user and the digest of the line before it."""
        time = (now or datetime.now(UTC)).isoformat(timespec="seconds")
        return replace(self, time=time, who=who, previous=previous)

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
            "previous": self.previous,
        }
        return (json.dumps({key: value for key, value in document.items() if _wanted(key, value)}) + "\n").encode()

    @classmethod
    def parse(cls, line: bytes) -> Self | None:
        """Parse a line. Return None if it is not an event."""
        try:
            document = json.loads(line)
        except (ValueError, RecursionError):
            return None
        if not isinstance(document, dict):
            return None
        texts = [document.get(key) for key in ("what", "time", "who")]
        optional = [document.get(key) for key in ("reason", "manifest", "previous")]
        before, to = document.get("from"), document.get("to")
        if not (
            all(isinstance(text, str) for text in texts)
            and all(text is None or isinstance(text, str) for text in optional)
            and all(number is None or type(number) is int for number in (before, to))
        ):
            return None
        what, time, who = map(str, texts)
        reason, manifest, previous = optional
        return cls(what, before, to, time, who, reason, manifest, previous)

    def as_document(self) -> dict[str, Any]:
        """Return the JSON document of the event."""
        document: dict[str, Any] = json.loads(self.render())
        return document


@dataclass(frozen=True)
class History:
    """A history as it was read: its events in order, and its faults in words."""

    events: tuple[Event, ...] = ()
    problems: tuple[str, ...] = ()
    torn_bytes: int = 0
    head: str = _NO_HASH  # ``previous`` of the next line

    @classmethod
    def parse(cls, content: bytes) -> Self:
        """Parse a history, verify its chain, and list the faults."""
        *lines, torn = content.split(b"\n")
        events: list[Event] = []
        problems: list[str] = []
        head, chained = hashlib.sha256(), False
        for number, line in enumerate((line + b"\n" for line in lines), start=1):
            event = Event.parse(line)
            if event is None:
                problems.append(f"line {number} is not an event")
            else:
                events.append(event)
                if event.previous is not None or chained:
                    if event.previous != head.hexdigest():
                        problems.append(f"the chain breaks at line {number}: a line before it was changed")
                    chained = True
            if chained:
                head = hashlib.sha256(line)
            else:
                head.update(line)
        if torn:
            problems.append(f"the last line is torn ({len(torn)} bytes): a writer was interrupted")
        return cls(tuple(events), tuple(problems), len(torn), head.hexdigest())

    def state(self, until: datetime | None = None) -> ModelState:
        """Return the state after all events up to and including an instant."""
        found = ModelState()
        for event in self.events:
            if until is not None and (moment := _moment(event.time)) is not None and moment > until:
                continue
            found = found.after(event)
        return found


def unrecorded(recorded: ModelState, actual: ModelState) -> Sequence[Event]:
    """Return the events that lead from the recorded state to the actual one."""
    return tuple(replace(event, reason=UNRECORDED) for event in _differences(recorded, actual))


def _differences(recorded: ModelState, actual: ModelState) -> Iterable[Event]:
    for version in sorted(actual.versions - recorded.versions):
        yield Event(PUBLISH, None, version)
    for alias in sorted(actual.aliases.keys() | recorded.aliases.keys()):
        before, to = recorded.aliases.get(alias), actual.aliases.get(alias)
        if before != to:
            yield Event.alias_move(alias, before, to)
    for version in sorted(recorded.versions - actual.versions):
        yield Event(REMOVE if version in actual.removed else VANISH, version, None)
    for version in sorted(actual.removed - recorded.removed - recorded.versions - actual.versions):
        yield Event(REMOVE, version, None)


def _moment(text: str) -> datetime | None:
    try:
        found = datetime.fromisoformat(text)
    except ValueError:
        return None
    return found if found.tzinfo is not None else found.replace(tzinfo=UTC)


def _wanted(key: str, value: object) -> bool:
    return value is not None or key in ("from", "to")


def current_user() -> str:
    """Return the name of the user that runs this process, or the number if it has no name."""
    try:
        return getpass.getuser()
    except (KeyError, OSError):  # a container's user without an entry in passwd
        return str(os.getuid())
