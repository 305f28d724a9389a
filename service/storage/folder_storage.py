"""A registry on a plain disk.

    <name>/<version>/             manifest.json  model.onnx  card.md     immutable once visible
    <name>/aliases/<alias>        one line: a version
    <name>/signatures/<version>   a detached signature, where there is one
    <name>/removed/<version>/     manifest.json of a removed version: its number is never used again
    <name>/history.jsonl          one line per change, and the lock of every writer
    <name>/history.head           number and sha256 of the last line

A version becomes visible by one rename of a complete, synced folder. It is removed by one rename into ``removed``.
Aliases are replaced by a rename. Writers hold an exclusive lock on the history. Staging folders that exist when the
lock is taken were left by a killed writer, and are deleted. Every write passes through the model's own folder, so one
stat of that folder shows every change. Links are never followed, and only plain files with one name are read.

What cannot be read is a fault of its own model, and within a model of its own alias, where the disk allows that.
"""

import contextlib
import errno
import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from service.errors import BrokenModelError, PublishError, RegistryError
from service.model.reference import is_alias, parse_version
from service.storage.base import MAX_HISTORY_BYTES, MAX_SIGNATURE_BYTES, Decision, RegistryFinding
from service.storage.disk import check_plain, lock, must_be_folder, read_plain, reason
from service.storage.folder_writer import HEAD, HISTORY, REMOVED, SIGNATURES, FolderWriter
from service.storage.history import ALIASES, NO_HEAD, Event, Head, History, ModelState
from service.storage.survey import folder_models_and_strangers, misplaced_files

MAX_HEAD_BYTES: Final = 128
MAX_ALIAS_BYTES: Final = 16
# A folder that changed this recently may change again within one tick of the disk's clock, so it is polled once more.
SETTLED_NS: Final = 100_000_000
_FOLDER: Final = os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC


@dataclass(frozen=True)
class FolderStorage:
    """See ``service.storage.base.Storage``."""

    root: Path

    def models(self) -> list[str]:
        """See ``Storage.models``. Links are left out."""
        return folder_models_and_strangers(self.root)[0]

    def strangers(self) -> Sequence[RegistryFinding]:
        """See ``Storage.strangers``."""
        return folder_models_and_strangers(self.root)[1]

    def state(self, name: str) -> ModelState:
        """See ``Storage.state``. Aliases are read before versions, so that every alias names a listed version."""
        aliases: dict[str, int] = {}
        faults: dict[str, str] = {}
        for alias in filter(is_alias, self._listed(name, ALIASES, faults)):
            try:
                if (version := self._alias(name, alias)) is not None:
                    aliases[alias] = version
            except BrokenModelError as error:
                faults[f"{ALIASES}/{alias}"] = str(error).removeprefix(f"{alias}: ")
        for file in (HISTORY, HEAD):
            try:
                with self._folder(name) as folder:
                    check_plain(folder, file)
            except BrokenModelError as error:
                if not isinstance(error.__cause__, FileNotFoundError):
                    faults[file] = str(error).removeprefix(f"{file}: ")
        versions = _numbers(self._entries(name))
        return ModelState(versions, aliases, _numbers(self._listed(name, REMOVED, faults)), faults)

    def files(self, name: str, version: int) -> list[str]:
        """See ``Storage.files``."""
        with self._folder(name, str(version)) as folder:
            return os.listdir(folder)  # noqa: PTH208 (of an open folder)

    def read(self, name: str, version: int, file: str, limit: int) -> bytes:
        """See ``Storage.read``."""
        with self._folder(name, str(version)) as folder:
            return read_plain(folder, file, limit)

    def publish(
        self, name: str, files: Mapping[str, bytes], manifest: Callable[[int], bytes], number: int | None = None
    ) -> int:
        """See ``Storage.publish``."""
        try:
            (self.root / name).mkdir(parents=True, exist_ok=True)
            with self._writing(name) as writer:
                return writer.publish(files, manifest, number)
        except OSError as error:
            raise PublishError(f"{name}: {reason(error)}; no version was published") from error

    def commit(self, name: str, decide: Decision) -> Event:
        """See ``Storage.commit``."""
        try:
            with self._writing(name) as writer:
                return writer.commit(decide(writer.state))
        except OSError as error:
            raise RegistryError(f"{name}: {reason(error)}; no change was made") from error

    def history(self, name: str) -> History:
        """See ``Storage.history``. The head is read first, so that a line that is added meanwhile is no fault."""
        head = self._head(name)
        if (lines := self._lines(name)) is not None:
            return History.parse(lines, head)
        if head is not None or not _numbers(self._entries(name)):
            return History.parse(b"", head)
        if (lines := self._lines(name)) is not None:  # the history is older than the versions, so now it must be there
            return History.parse(lines)
        return History(problems=(f"{HISTORY} is missing, although there are versions",))

    def _lines(self, name: str) -> bytes | None:
        """Return the bytes of a history, or None if there is none."""
        try:
            with self._folder(name) as folder:
                return read_plain(folder, HISTORY, MAX_HISTORY_BYTES)
        except BrokenModelError as error:
            if isinstance(error.__cause__, FileNotFoundError):
                return None
            raise

    def _head(self, name: str) -> Head | None:
        """Return the recorded end of a history, or None for a history that has none."""
        try:
            with self._folder(name) as folder:
                content = read_plain(folder, HEAD, MAX_HEAD_BYTES)
        except BrokenModelError as error:
            return None if isinstance(error.__cause__, FileNotFoundError) else NO_HEAD
        return Head.parse(content) or NO_HEAD

    def signature(self, name: str, version: int) -> bytes | None:
        """See ``Storage.signature``."""
        if str(version) not in self._entries(name, SIGNATURES):
            return None
        with self._folder(name, SIGNATURES) as folder:
            return read_plain(folder, str(version), MAX_SIGNATURE_BYTES)

    def sign(self, name: str, version: int, signature: bytes) -> None:
        """See ``Storage.sign``."""
        try:
            with self._writing(name) as writer:
                writer.sign(version, signature)
        except OSError as error:
            raise RegistryError(f"{name}@{version}: {reason(error)}; the version was not signed") from error

    def fingerprint(self) -> tuple[tuple[str, object, bool], ...]:
        """See ``Storage.fingerprint``. Makes one listing, and one stat per model."""
        return tuple((name, *_modified(self.root / name)) for name in self.models())

    def survey(self) -> Sequence[RegistryFinding]:
        """See ``Storage.survey``."""
        names, found = folder_models_and_strangers(self.root)
        for name in names:
            with contextlib.suppress(RegistryError):
                found += misplaced_files(name, self._entries)
        return found

    def _alias(self, name: str, alias: str) -> int | None:
        """Return the version that an alias names. None: the alias was dropped in the meantime.

        Raises:
            BrokenModelError: its file cannot be read, or names no version.
        """
        try:
            with self._folder(name, ALIASES) as folder:
                content = read_plain(folder, alias, MAX_ALIAS_BYTES)
        except BrokenModelError as error:
            if isinstance(error.__cause__, FileNotFoundError):
                return None
            raise
        version = parse_version(content.decode("ascii", "replace").strip())
        if version is None:
            raise BrokenModelError(f"{alias}: holds no number of a version")
        return version

    def _listed(self, name: str, part: str, faults: dict[str, str]) -> list[str]:
        """Return the names in a folder of a model. A folder that cannot be listed is a fault."""
        try:
            return self._entries(name, part)
        except RegistryError as error:
            faults[part] = str(error).removeprefix(f"{name}/{part}: ")
            return []

    def _entries(self, *parts: str) -> list[str]:
        """Return the names in a folder of the registry. A missing folder has none."""
        try:
            with self._folder(*parts) as folder:
                return os.listdir(folder)  # noqa: PTH208 (of an open folder)
        except BrokenModelError as error:
            if isinstance(error.__cause__, FileNotFoundError) and self.root.is_dir():
                return []
            raise
        except OSError as error:
            raise BrokenModelError(f"{'/'.join(parts)}: {reason(error)}") from error

    @contextlib.contextmanager
    def _folder(self, *parts: str) -> Iterator[int]:
        """Open a folder below the root step by step, so that no step is a link."""
        try:
            descriptor = os.open(self.root, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        except OSError as error:
            raise BrokenModelError(f"the registry cannot be opened: {reason(error)}") from error
        try:
            for part in parts:
                try:
                    below = os.open(part, _FOLDER, dir_fd=descriptor)
                except OSError as error:
                    linked = error.errno in (errno.ENOTDIR, errno.ELOOP)
                    cause = "not a plain folder; links are not followed" if linked else reason(error)
                    raise BrokenModelError(f"{'/'.join(parts)}: {cause}") from error
                os.close(descriptor)
                descriptor = below
            yield descriptor
        finally:
            os.close(descriptor)

    @contextlib.contextmanager
    def _writing(self, name: str) -> Iterator[FolderWriter]:
        """Lock a model for one writer, and finish the work of writers that were killed."""
        must_be_folder(self.root / name)
        descriptor = lock(self.root / name / HISTORY)
        try:
            writer = FolderWriter(self.root / name, descriptor, self.history(name), lambda: self.state(name))
            writer.recover()
            yield writer
        finally:
            os.close(descriptor)


def _numbers(entries: list[str]) -> frozenset[int]:
    return frozenset(number for entry in entries if (number := parse_version(entry)) is not None)


def _modified(folder: Path) -> tuple[object, bool]:
    """Return the time of a folder's last change in ns, and whether a later change is sure to have another time.

    A folder that cannot be asked has its reason in place of the time.
    """
    try:
        modified = folder.stat().st_mtime_ns
    except OSError as error:
        return reason(error), True
    return modified, not 0 <= time.time_ns() - modified < SETTLED_NS
