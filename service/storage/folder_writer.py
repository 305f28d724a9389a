"""Writer of one change to one model on a plain disk. The caller holds the lock on the model's history."""

import contextlib
import hashlib
import os
import secrets
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Final

from service.errors import RegistryError
from service.model.manifest import MANIFEST_FILE
from service.storage.disk import discard, must_be_folder, reason, sync, write_all, write_synced
from service.storage.history import (
    ALIASES,
    INTERRUPTED,
    PUBLISH,
    REPAIR,
    SIGN,
    Event,
    Head,
    History,
    ModelState,
    current_user,
    unrecorded,
)

HISTORY: Final = "history.jsonl"
HEAD: Final = "history.head"
REMOVED: Final = "removed"
SIGNATURES: Final = "signatures"
STAGING_PREFIX: Final = ".staging-"
_DROPPED: Final = "drop."  # of a staged alias: its name follows, so that a killed writer's order is known


class FolderWriter:
    """The only writer of a model's folder. Call ``recover`` first, then make one change."""

    def __init__(self, folder: Path, descriptor: int, history: History, state: Callable[[], ModelState]) -> None:
        self._folder = folder
        self._descriptor = descriptor  # of the history, open for appending
        self._history = history
        self._state = state
        self.state = ModelState()

    def recover(self) -> None:
        """Delete staging folders, finish removals, cut off a torn line, record unrecorded changes and repairs."""
        staged = [entry for entry in self._folder.iterdir() if entry.name.startswith(STAGING_PREFIX)]
        dropped = {alias: entry for entry in staged if (alias := _dropped_alias(entry.name)) is not None}
        for entry in set(staged) - set(dropped.values()):
            discard(entry)
        self.state = self._state()
        for version in self.state.removed - self.state.versions:
            self._delete_content(version)
        if self._history.torn_bytes:
            size = os.fstat(self._descriptor).st_size
            os.ftruncate(self._descriptor, size - self._history.torn_bytes)
            self._record(Event(REPAIR, None, None, reason=self._history.problems[-1]))
        if self._history.cut is not None:
            self._record(Event(REPAIR, None, None, reason=self._history.cut))
        for event in unrecorded(self._history.state(), self.state):
            ordered = event.to is None and event.alias in dropped
            self._record(replace(event, reason=INTERRUPTED) if ordered else event)
        for entry in dropped.values():
            discard(entry)

    def publish(self, files: Mapping[str, bytes], manifest: Callable[[int], bytes], number: int | None) -> int:
        """Stage, sync, rename and record a version. Return its number."""
        recorded = self._history.state()
        known = ModelState(self.state.versions | recorded.versions, removed=self.state.removed | recorded.removed)
        version = known.free_number(number)
        content = manifest(version)
        with self._staging() as staging:
            staging.mkdir()
            for file, part in (*files.items(), (MANIFEST_FILE, content)):
                write_synced(staging / file, part)
            sync(staging)
            staging.rename(self._folder / str(version))
        event = Event(PUBLISH, None, version, manifest=hashlib.sha256(content).hexdigest())
        with self._recording(event):
            sync(self._folder)
            sync(self._folder.parent)
            self._record(event)
        return version

    def commit(self, event: Event) -> Event:
        """Move an alias or remove a version, as the event says. Return the recorded event.

        What had disappeared before is removed too: only the order is recorded then.
        """
        if event.alias is not None and event.to is None:
            return self._drop(event, event.alias)
        if event.alias is not None:
            folder = self._folder / ALIASES
            self._put(ALIASES, event.alias, f"{event.to}\n".encode())
        else:
            folder = self._folder / REMOVED
            folder.mkdir(exist_ok=True)
            try:
                (self._folder / str(event.before)).rename(folder / str(event.before))
            except FileNotFoundError:
                (folder / str(event.before)).mkdir(exist_ok=True)
        with self._recording(event):
            sync(folder)
            sync(self._folder)
            recorded = self._record(event)
        if event.alias is None and event.before is not None:
            self._delete_content(event.before)
        return recorded

    def _drop(self, event: Event, alias: str) -> Event:
        """Drop an alias through the model's folder, so that its time changes. The staged file keeps the order."""
        folder = self._folder / ALIASES
        with self._staging(f"{_DROPPED}{alias}.") as staging:
            with contextlib.suppress(FileNotFoundError):
                (folder / alias).rename(staging)
            with self._recording(event):
                if folder.is_dir():
                    sync(folder)
                sync(self._folder)
                return self._record(event)

    def sign(self, version: int, signature: bytes) -> None:
        """Store the signature of a version beside it."""
        self._put(SIGNATURES, str(version), signature)
        with self._recording(event := Event(SIGN, None, version)):
            sync(self._folder / SIGNATURES)
            self._record(event)

    def _put(self, folder: str, file: str, content: bytes) -> None:
        """Create or replace a small file in a folder of the model.

        It is staged in the model's own folder, so that one stat of that folder shows the change.
        """
        target = self._folder / folder
        target.mkdir(exist_ok=True)
        must_be_folder(target)
        with self._staging() as staging:
            write_synced(staging, content)
            staging.rename(target / file)

    def _delete_content(self, version: int) -> None:
        """Delete the files of a removed version, except its manifest. The next writer retries if the disk refuses."""
        folder = self._folder / REMOVED / str(version)
        with contextlib.suppress(OSError):
            (self._folder / SIGNATURES / str(version)).unlink(missing_ok=True)
            for entry in folder.iterdir():
                if entry.name != MANIFEST_FILE:
                    discard(entry)

    @contextlib.contextmanager
    def _staging(self, purpose: str = "") -> Iterator[Path]:
        """Provide a path in the model's folder, and delete the entry that is left there afterwards."""
        path = self._folder / f"{STAGING_PREFIX}{purpose}{secrets.token_hex(8)}"
        try:
            yield path
        finally:
            with contextlib.suppress(OSError):
                discard(path)

    @contextlib.contextmanager
    def _recording(self, event: Event) -> Iterator[None]:
        """Report a failure of the disk as an unrecorded change: the change itself is visible already."""
        try:
            yield
        except OSError as error:
            which = event.before if event.to is None else event.to
            raise RegistryError(
                f"{self._folder.name}: {event.what} of {which} is done, but could not be recorded: {reason(error)}; "
                "the next change records it"
            ) from error

    def _record(self, event: Event) -> Event:
        """Append a line to the history, whole or not at all, and record it as the last one."""
        number = self._history.length + 1
        stamped = event.stamped(current_user(), self._history.head, number=number)
        line = stamped.render()
        size = os.fstat(self._descriptor).st_size
        try:
            write_all(self._descriptor, line)
            os.fsync(self._descriptor)
        except OSError:
            os.ftruncate(self._descriptor, size)
            raise
        head = Head(number, hashlib.sha256(line).hexdigest())
        self._history = History((*self._history.events, stamped), head=head.digest, length=number)
        self._keep_head(head)
        return stamped

    def _keep_head(self, head: Head) -> None:
        """Replace the recorded end of the history. If the disk refuses, the next change records a later one."""
        with contextlib.suppress(OSError), self._staging() as staging:
            write_synced(staging, head.render())
            staging.rename(self._folder / HEAD)
            sync(self._folder)


def _dropped_alias(staged: str) -> str | None:
    """Return the alias whose drop a staged file belongs to, or None."""
    purpose = staged.removeprefix(STAGING_PREFIX)
    return purpose.removeprefix(_DROPPED).rpartition(".")[0] or None if purpose.startswith(_DROPPED) else None
