"""A registry on a plain disk.

    <name>/<version>/             manifest.json  model.onnx  card.md     immutable once visible
    <name>/aliases/<alias>        one line: a version
    <name>/signatures/<version>   a detached signature, where there is one
    <name>/removed/<version>/     manifest.json of a removed version: its number is never used again
    <name>/history.jsonl          one line per change, and the lock of every writer

A version becomes visible by one rename of a complete, synced folder. It is removed by one rename into ``removed``.
Aliases are replaced by a rename. Writers hold an exclusive lock on the history. Staging folders that exist when the
lock is taken were left by a killed writer, and are deleted. Every write passes through the model's own folder, so one
stat of that folder shows every change. Links are never followed, and only plain files with one name are read.
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
from service.model.reference import is_alias, is_name, parse_version
from service.storage.base import MAX_HISTORY_BYTES, MAX_SIGNATURE_BYTES, Decision, RegistryFinding
from service.storage.disk import lock, must_be_folder, read_plain, reason
from service.storage.folder_writer import ALIASES, REMOVED, SIGNATURES, STAGING_PREFIX, FolderWriter
from service.storage.history import Event, History, ModelState

HISTORY: Final = "history.jsonl"
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
        try:
            with os.scandir(self.root) as entries:
                return sorted(e.name for e in entries if is_name(e.name) and e.is_dir(follow_symlinks=False))
        except OSError as error:
            raise RegistryError(f"the registry cannot be listed: {error.strerror}") from error

    def state(self, name: str) -> ModelState:
        """See ``Storage.state``. Aliases are read before versions, so that every alias names a listed version."""
        aliases = {}
        for alias in filter(is_alias, self._entries(name, ALIASES)):
            if (version := self._alias(name, alias)) is not None:
                aliases[alias] = version
        return ModelState(_numbers(self._entries(name)), aliases, _numbers(self._entries(name, REMOVED)))

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
        """See ``Storage.history``."""
        try:
            with self._folder(name) as folder:
                return History.parse(read_plain(folder, HISTORY, MAX_HISTORY_BYTES))
        except BrokenModelError as error:
            if isinstance(error.__cause__, FileNotFoundError):
                return History()
            raise

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

    def fingerprint(self) -> tuple[tuple[str, int, bool], ...]:
        """See ``Storage.fingerprint``. Makes one listing, and one stat per model."""
        return tuple((name, *_modified(self.root / name)) for name in self.models())

    def survey(self) -> Sequence[RegistryFinding]:
        """See ``Storage.survey``."""
        found = []
        self.models()  # raises if the root cannot be listed
        for entry in sorted(self.root.iterdir()):
            if not is_name(entry.name) or entry.is_symlink() or not entry.is_dir():
                if not entry.name.startswith("."):
                    found.append(
                        RegistryFinding(entry.name, "is not a model's folder", "move it elsewhere", severe=False)
                    )
                continue
            found += [
                self._unexpected(entry.name, part)
                for part in sorted(self._entries(entry.name))
                if not _is_expected(part)
            ]
        return found

    def _unexpected(self, name: str, part: str) -> RegistryFinding:
        if part.startswith(STAGING_PREFIX):
            advice = "a writer was interrupted, or is still writing; the next change deletes it"
            return RegistryFinding(f"{name}/{part}", "is incomplete", advice, severe=False)
        return RegistryFinding(f"{name}/{part}", "is not part of the layout", "move it elsewhere", severe=False)

    def _alias(self, name: str, alias: str) -> int | None:
        """Return the version that an alias names, or None if the file holds no version.

        Raises:
            RegistryError: the disk failed, which is not the same as a missing alias.
        """
        try:
            with self._folder(name, ALIASES) as folder:
                content = read_plain(folder, alias, MAX_ALIAS_BYTES)
        except BrokenModelError as error:
            if isinstance(error.__cause__, OSError) and error.__cause__.errno not in (errno.ENOENT, errno.ELOOP):
                raise RegistryError(f"{name}@{alias} cannot be read: {reason(error.__cause__)}") from error
            return None
        return parse_version(content.decode("ascii", "replace").strip())

    def _entries(self, *parts: str) -> list[str]:
        """Return the names in a folder of the registry. A missing folder has none."""
        try:
            with self._folder(*parts) as folder:
                return os.listdir(folder)  # noqa: PTH208 (of an open folder)
        except BrokenModelError as error:
            if isinstance(error.__cause__, FileNotFoundError) and self.root.is_dir():
                return []
            raise RegistryError(f"the registry cannot be listed: {error}") from error
        except OSError as error:
            raise RegistryError(f"the registry cannot be listed: {reason(error)}") from error

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
                    linked = error.errno == errno.ENOTDIR
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


def _is_expected(part: str) -> bool:
    return part in (ALIASES, REMOVED, SIGNATURES, HISTORY) or parse_version(part) is not None


def _modified(folder: Path) -> tuple[int, bool]:
    """Return the time of a folder's last change in ns, and whether a later change is sure to have another time."""
    try:
        modified = folder.stat().st_mtime_ns
    except OSError as error:
        raise RegistryError(f"the registry cannot be listed: {reason(error)}") from error
    return modified, not 0 <= time.time_ns() - modified < SETTLED_NS
