"""History of a model as a chain of lines: publish, alias move, removal. This module reads and writes no files.

``history.jsonl`` holds one JSON object per line: ``time`` (UTC, ISO 8601), ``who``, ``what``, ``from``, ``to``,
``reason``, ``number`` of the line, and ``previous``: the sha256 of the line before it, newline included. Changing,
removing or inserting a line breaks the chain at that place. Lines without ``previous`` are accepted only at the start
of a history and from the days before chains existed. The first line with ``previous`` covers all of them.

The end of the chain is kept beside the lines, as a ``Head``, so that a history that is cut at its end is noticed too.

A writer that is killed leaves at most a torn last line, a change without a line, or a line that the head lacks. The
next writer cuts off the torn line or adds the missing one, and records that it did.

A history tells what was asked for from what was only found. A version or an alias that disappeared without a writer's
order is recorded once it is noticed, but ``History.intended`` keeps it.
"""

import hashlib
import re
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Final, Self

from service.errors import BrokenModelError
from service.storage.events import (
    ALIASES,
    INTERRUPTED,
    MAX_LINE_BYTES,
    PUBLISH,
    REMOVE,
    REPAIR,
    SIGN,
    UNRECORDED,
    Event,
    ModelState,
    current_user,
    unrecorded,
)

__all__ = [
    "ALIASES",
    "CHAINED_SINCE",
    "INTERRUPTED",
    "MAX_LINE_BYTES",
    "NO_HEAD",
    "PUBLISH",
    "REMOVE",
    "REPAIR",
    "SIGN",
    "UNRECORDED",
    "Event",
    "Head",
    "History",
    "ModelState",
    "current_user",
    "unrecorded",
]

_NO_HASH: Final = hashlib.sha256().hexdigest()
_HEAD: Final = re.compile(rb"([0-9]{1,9}) ([0-9a-f]{64})\n")
MAX_LINES: Final = 1 << 18
MAX_PROBLEMS: Final = 100  # that are listed. The others are counted
CHAINED_SINCE: Final = datetime(2026, 11, 24, tzinfo=UTC)  # older lines may have no ``previous``


@dataclass(frozen=True)
class Head:
    """End of a history: the number of its lines, and the sha256 of the last one."""

    length: int
    digest: str

    @classmethod
    def parse(cls, content: bytes) -> Self | None:
        """Parse a head. Return None if it is not one."""
        found = _HEAD.fullmatch(content)
        return None if found is None else cls(int(found[1]), found[2].decode())

    def render(self) -> bytes:
        """Render the head as one line."""
        return f"{self.length} {self.digest}\n".encode()


NO_HEAD: Final = Head(0, "")  # stands for one that cannot be read


@dataclass(frozen=True)
class History:
    """A history as it was read: its events in order, and its faults in words."""

    events: tuple[Event, ...] = ()
    problems: tuple[str, ...] = ()
    torn_bytes: int = 0
    head: str = _NO_HASH  # ``previous`` of the next line
    length: int = 0  # whole lines
    cut: str | None = None  # one of the problems: lines are missing at the end

    @classmethod
    def parse(cls, content: bytes, head: Head | None = None) -> Self:
        """Parse a history, verify its chain and compare it with its recorded end. List the faults.

        Lines after the recorded end are no fault: a writer was interrupted before it recorded them.

        Raises:
            BrokenModelError: there are more than ``MAX_LINES`` lines.
        """
        if content.count(b"\n") > MAX_LINES:
            raise BrokenModelError(f"the history has more than {MAX_LINES} lines")
        *lines, torn = content.split(b"\n")
        events: list[Event] = []
        problems: list[str] = []
        digest, chained, found_head = hashlib.sha256(), False, head is None
        for number, line in enumerate((line + b"\n" for line in lines), start=1):
            event = Event.parse(line)
            if event is None:
                problems.append(f"line {number} is not an event")
            else:
                events.append(event)
                if event.previous is not None or chained:
                    if event.previous != digest.hexdigest():
                        problems.append(f"the chain breaks at line {number}: a line before it was changed")
                    chained = True
                elif not _is_older_than_chains(event):
                    problems.append(f"line {number} has no link to the line before it: the chain was taken out")
            if head is not None and number == head.length:
                found_head = hashlib.sha256(line).hexdigest() == head.digest
            if chained:
                digest = hashlib.sha256(line)
            else:
                digest.update(line)
        cut = None
        if head == NO_HEAD:
            cut = "the record of its last line cannot be read, so lines may have been cut off"
        elif not found_head and head is not None and not (torn and head.length == len(lines) + 1):
            cut = f"the last line is not line {head.length} as it was recorded: lines were cut off or changed"
        elif head is None and sum(event.number is not None for event in events) > 1:  # after one it is about to be
            cut = "the record of its last line is missing, so lines may have been cut off"
        if len(problems) > MAX_PROBLEMS:
            problems[MAX_PROBLEMS:] = [f"{len(problems) - MAX_PROBLEMS} more faults"]
        if cut is not None:
            problems.append(cut)
        if torn:
            problems.append(f"the last line is torn ({len(torn)} bytes): a writer was interrupted")
        return cls(tuple(events), tuple(problems), len(torn), digest.hexdigest(), len(lines), cut)

    def intended(self) -> ModelState:
        """Return the state that writers asked for. What only disappeared is still part of it."""
        found = ModelState()
        for event in self.events:
            found = found if event.is_absence else found.after(event)
        return found

    def lost(self, actual: ModelState) -> ModelState:
        """Return the versions and aliases that writers asked for and never removed, and that are not there."""
        intended = self.intended()
        absent = {
            alias: version
            for alias, version in intended.aliases.items()
            if alias not in actual.aliases and not actual.is_unknown(alias)
        }
        return ModelState(intended.versions - actual.versions - actual.removed, absent)

    def gave_up(self, alias: str) -> bool:
        """Return whether a writer dropped an alias, and no writer set it again."""
        return alias not in self.intended().aliases and any(event.alias == alias for event in self.events)

    def has_signing(self, version: int) -> bool:
        """Return whether the history has the signing of a version."""
        return any(event.what == SIGN and event.to == version for event in self.events)

    def state(self, until: datetime | None = None) -> ModelState:
        """Return the state after all events up to and including an instant."""
        found = ModelState()
        for event in self.events:
            if until is not None and (moment := _moment(event.time)) is not None and moment > until:
                continue
            found = found.after(event)
        return found


def _is_older_than_chains(event: Event) -> bool:
    moment = _moment(event.time)
    return moment is not None and moment < CHAINED_SINCE


def _moment(text: str) -> datetime | None:
    try:
        found = datetime.fromisoformat(text)
    except ValueError:
        return None
    return found if found.tzinfo is not None else found.replace(tzinfo=UTC)
