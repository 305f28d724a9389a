"""What happened to a model, as a chain of lines: publish, alias move, removal. Pure: text in, text out.

``history.jsonl`` holds one JSON object per line: ``time`` (UTC, ISO 8601), ``who``, ``what``, ``from``, ``to``,
``reason``, and ``previous``: the sha256 of the line before it, newline included. Whoever changes, removes or inserts a
line breaks the chain there. The first line that carries ``previous`` vouches for everything before it, so a history
that began before there was a chain goes on as one.

A writer that is killed leaves at most a torn last line, or a change that no line tells of: the next writer cuts the
one, records the other, and says so.
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
UNRECORDED: Final = "found so, and recorded afterwards: a writer was interrupted, or files were changed by hand"
Texts = str | None


@dataclass(frozen=True)
class ModelState:
    """What is visible of a model: its versions, where its aliases point, and the numbers that are spent."""

    versions: frozenset[int] = frozenset()
    aliases: Mapping[str, int] = field(default_factory=dict)
    removed: frozenset[int] = frozenset()

    @property
    def next_version(self) -> int:
        """The smallest number above every number that was ever visible."""
        return max(self.versions | self.removed, default=0) + 1

    def free(self, number: int | None) -> int:
        """The number that is asked for, if it was never visible, or else the next one.

        Raises:
            ConflictError: it was.
        """
        if number is not None and number in self.versions | self.removed:
            raise ConflictError(
                f"version {number} is {'taken' if number in self.versions else 'spent: it was removed'}"
            )
        return self.next_version if number is None else number

    def after(self, event: "Event") -> "ModelState":
        """The state once an event has happened."""
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
    """One thing that happened; ``before`` is written as ``from``."""

    what: str
    before: int | None
    to: int | None
    time: str = ""
    who: str = ""
    reason: Texts = None
    manifest: Texts = None  # sha256 of the manifest that was published
    previous: Texts = None  # None only on lines from before there was a chain

    @property
    def alias(self) -> Texts:
        """The alias that moved, if one did."""
        return self.what.removeprefix(_ALIAS) if self.what.startswith(_ALIAS) else None

    @classmethod
    def alias_move(cls, alias: str, before: int | None, to: int | None, reason: Texts = None) -> Self:
        """An alias that points elsewhere from now on."""
        return cls(f"{_ALIAS}{alias}", before, to, reason=reason)

    def signed_off(self, who: str, previous: str, now: datetime | None = None) -> Self:
        """The event with its time, its user and its place in the chain."""
        time = (now or datetime.now(UTC)).isoformat(timespec="seconds")
        return replace(self, time=time, who=who, previous=previous)

    def render(self) -> bytes:
        """One line."""
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
        """Read a line; None where it is none."""
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
        """For output."""
        document: dict[str, Any] = json.loads(self.render())
        return document


@dataclass(frozen=True)
class History:
    """A history as it was read: its events in order, and what is wrong with it."""

    events: tuple[Event, ...] = ()
    problems: tuple[str, ...] = ()
    torn_bytes: int = 0
    head: str = _NO_HASH  # what the next line must carry

    @classmethod
    def parse(cls, content: bytes) -> Self:
        """Read a history, follow its chain, and say where it does not hold."""
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
                        problems.append(f"the chain breaks at line {number}: what stands before it was changed")
                    chained = True
            if chained:
                head = hashlib.sha256(line)
            else:
                head.update(line)
        if torn:
            problems.append(f"the last line is torn ({len(torn)} bytes): a writer was interrupted")
        return cls(tuple(events), tuple(problems), len(torn), head.hexdigest())

    def state(self, until: datetime | None = None) -> ModelState:
        """The state that the events lead to, up to and including an instant."""
        found = ModelState()
        for event in self.events:
            if until is not None and (moment := _moment(event.time)) is not None and moment > until:
                continue
            found = found.after(event)
        return found


def unrecorded(recorded: ModelState, actual: ModelState) -> Sequence[Event]:
    """What must have happened between what the history tells and what is there."""
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


def user() -> str:
    """Who changes something, for the history."""
    try:
        return getpass.getuser()
    except (KeyError, OSError):  # a container's user without an entry in passwd
        return str(os.getuid())
