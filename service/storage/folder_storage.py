"""A registry on a plain disk.

    <name>/<version>/             manifest.json  model.onnx  card.md     immutable once visible
    <name>/aliases/<alias>        one line: a version
    <name>/signatures/<version>   a detached signature, where there is one
    <name>/removed/<version>/     manifest.json of a removed version: its number is spent
    <name>/history.jsonl          one line per change, and the lock of every writer

A version becomes visible by one rename of a folder that is whole and synced, and goes by one rename into ``removed``.
Aliases are replaced by a rename. Writers hold an exclusive lock on the history, so whatever lies in staging while the
lock is held was left by a writer that died: it is swept. Everything written passes through the model's own folder, so
that one stat of it tells of every change. Links are never followed, and only plain files with one name are read.
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
from service.storage.base import MAX_HISTORY_BYTES, MAX_SIGNATURE_BYTES, Decision, Finding
from service.storage.disk import lock, must_be_folder, read_plain, reason
from service.storage.folder_writer import ALIASES, REMOVED, SIGNATURES, STAGING_PREFIX, FolderWriter
from service.storage.history import Event, History, ModelState

HISTORY: Final = "history.jsonl"
MAX_ALIAS_BYTES: Final = 16
# A folder that changed this recently may change again within one tick of the disk's clock: look once more.
SETTLED_NS: Final = 100_000_000
_FOLDER: Final = os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC


@dataclass(frozen=True)
class FolderStorage:
    """See ``service.storage.base.Storage``."""

    root: Path

    def models(self) -> list[str]:
        """See ``Storage.models``; links are not models."""
        try:
            with os.scandir(self.root) as entries:
                return sorted(e.name for e in entries if is_name(e.name) and e.is_dir(follow_symlinks=False))
        except OSError as error:
            raise RegistryError(f"the registry cannot be listed: {error.strerror}") from error

    def state(self, name: str) -> ModelState:
        """See ``Storage.state``; aliases are read first, so that a version is there before its alias is."""
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
            raise PublishError(f"{name}: {reason(error)}; nothing was published") from error

    def commit(self, name: str, decide: Decision) -> Event:
        """See ``Storage.commit``."""
        try:
            with self._writing(name) as writer:
                return writer.commit(decide(writer.state))
        except OSError as error:
            raise RegistryError(f"{name}: {reason(error)}; nothing was changed") from error

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
            raise RegistryError(f"{name}@{version}: {reason(error)}; it was not signed") from error

    def fingerprint(self) -> tuple[tuple[str, int, bool], ...]:
        """See ``Storage.fingerprint``: one listing, and one stat per model."""
        return tuple((name, *_modified(self.root / name)) for name in self.models())

    def survey(self) -> Sequence[Finding]:
        """See ``Storage.survey``."""
        found = []
        self.models()  # raises where nothing can be told
        for entry in sorted(self.root.iterdir()):
            if not is_name(entry.name) or entry.is_symlink() or not entry.is_dir():
                if not entry.name.startswith("."):
                    found.append(Finding(entry.name, "is not a model's folder", "move it elsewhere", severe=False))
                continue
            found += [self._odd(entry.name, part) for part in sorted(self._entries(entry.name)) if _is_odd(part)]
        return found

    def _odd(self, name: str, part: str) -> Finding:
        if part.startswith(STAGING_PREFIX):
            advice = "left by a writer that was interrupted, or being written now; the next change sweeps it"
            return Finding(f"{name}/{part}", "is not finished", advice, severe=False)
        return Finding(f"{name}/{part}", "is no part of the layout", "move it elsewhere", severe=False)

    def _alias(self, name: str, alias: str) -> int | None:
        """Where an alias points; None for what is no alias. A disk that fails to tell is an error, not an answer."""
        try:
            with self._folder(name, ALIASES) as folder:
                content = read_plain(folder, alias, MAX_ALIAS_BYTES)
        except BrokenModelError as error:
            if isinstance(error.__cause__, OSError) and error.__cause__.errno not in (errno.ENOENT, errno.ELOOP):
                raise RegistryError(f"{name}@{alias} cannot be read: {reason(error.__cause__)}") from error
            return None
        return parse_version(content.decode("ascii", "replace").strip())

    def _entries(self, *parts: str) -> list[str]:
        """The names in a folder; none of one that is not there."""
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
        """A folder below the root, opened step by step: no step is a link."""
        try:
            descriptor = os.open(self.root, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        except OSError as error:
            raise BrokenModelError(f"the registry cannot be opened: {reason(error)}") from error
        try:
            for part in parts:
                try:
                    below = os.open(part, _FOLDER, dir_fd=descriptor)
                except OSError as error:
                    why = (
                        "not a plain folder; links are not followed" if error.errno == errno.ENOTDIR else reason(error)
                    )
                    raise BrokenModelError(f"{'/'.join(parts)}: {why}") from error
                os.close(descriptor)
                descriptor = below
            yield descriptor
        finally:
            os.close(descriptor)

    @contextlib.contextmanager
    def _writing(self, name: str) -> Iterator[FolderWriter]:
        """The only writer of a model, with what others left undone put right."""
        must_be_folder(self.root / name)
        descriptor = lock(self.root / name / HISTORY)
        try:
            writer = FolderWriter(self.root / name, descriptor, self.history(name), lambda: self.state(name))
            writer.put_right()
            yield writer
        finally:
            os.close(descriptor)


def _numbers(entries: list[str]) -> frozenset[int]:
    return frozenset(number for entry in entries if (number := parse_version(entry)) is not None)


def _is_odd(part: str) -> bool:
    known = part in (ALIASES, REMOVED, SIGNATURES, HISTORY) or parse_version(part) is not None
    return not known


def _modified(folder: Path) -> tuple[int, bool]:
    """When a folder changed, and whether that is long enough ago to be told from a later change."""
    try:
        modified = folder.stat().st_mtime_ns
    except OSError as error:
        raise RegistryError(f"the registry cannot be listed: {reason(error)}") from error
    return modified, not 0 <= time.time_ns() - modified < SETTLED_NS
