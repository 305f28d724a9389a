"""The folder of models: list, resolve, read verified bytes, publish, point aliases.

    models/<name>/<version>/   manifest.json  model.onnx  card.md     immutable once visible
    models/<name>/aliases/     champion ...                           one line each: a version
    models/<name>/history.jsonl                                       one line per publish and alias move

Rules: versions are positive integers. A version becomes visible by one rename of a folder that is whole and synced, so
a kill at any instant leaves a whole version or none. Aliases are replaced atomically. Reading never writes. Nothing
found on disk is trusted: names are checked, real paths must lie inside the registry, only regular files are read,
sizes are bounded before reading, digests are compared before anyone gets a byte.
"""

import contextlib
import errno
import getpass
import json
import os
import secrets
import shutil
import stat
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Final

from service.errors import BrokenModelError, PublishError, RegistryError, UnknownModelError
from service.manifest import (
    CARD_FILE,
    MANIFEST_FILE,
    MODEL_FILE,
    FileDigest,
    Manifest,
    ModelReference,
    is_alias,
    is_name,
    parse_version,
)

ALIASES_FOLDER: Final = "aliases"
HISTORY_FILE: Final = "history.jsonl"
STAGING_PREFIX: Final = ".staging-"
MAX_MANIFEST_BYTES: Final = 1 << 20
MAX_MODEL_BYTES: Final = 64 << 20
MAX_CARD_BYTES: Final = 1 << 20
MAX_ALIAS_BYTES: Final = 16
_TAKEN: Final = (errno.EEXIST, errno.ENOTEMPTY)


@dataclass(frozen=True)
class VerifiedVersion:
    """A version whose bytes are those that its manifest vouches for."""

    manifest: Manifest
    model: bytes
    card: str


@dataclass(frozen=True)
class Registry:
    """A registry of models in one folder."""

    root: Path

    def names(self) -> list[str]:
        """The models, sorted.

        Raises:
            RegistryError: the folder cannot be listed.
        """
        return sorted(name for name in _listing(self.root) if is_name(name) and _is_folder(self.root / name))

    def versions(self, name: str) -> list[int]:
        """The visible versions of a model, oldest first; as numbers, so that 10 is newer than 9.

        Raises:
            RegistryError: the folder cannot be listed.
        """
        numbers = (parse_version(entry) for entry in _listing(self._folder(name)))
        return sorted(number for number in numbers if number is not None)

    def aliases(self, name: str) -> dict[str, int]:
        """Where each alias of a model points; a file that is not an alias is left out.

        Raises:
            RegistryError: the folder is there and cannot be listed.
        """
        folder = self._folder(name) / ALIASES_FOLDER
        if not _is_folder(folder):
            return {}
        found: dict[str, int] = {}
        for alias in sorted(filter(is_alias, _listing(folder))):
            with contextlib.suppress(BrokenModelError):
                version = parse_version(
                    self._read_file(folder / alias, MAX_ALIAS_BYTES).decode("ascii", "replace").strip()
                )
                if version is not None:
                    found[alias] = version
        return found

    def resolve(self, reference: ModelReference) -> int:
        """The version that a reference means now.

        Raises:
            UnknownModelError: there is no such model, version or alias.
        """
        if reference.name not in self.names():
            raise UnknownModelError(f"there is no model {reference.name}")
        known = self.versions(reference.name)
        version = reference.version
        if reference.alias is not None:
            version = self.aliases(reference.name).get(reference.alias)
        if version not in known:
            raise UnknownModelError(f"there is no {reference}; versions of {reference.name}: {_numbers(known)}")
        return version

    def read(self, name: str, version: int) -> VerifiedVersion:
        """Every byte of a version, verified: format, sizes, digests, no file too many or too few.

        Raises:
            BrokenModelError: names the file that is at fault, what was found and what was expected.
        """
        folder = self._folder(name) / str(version)
        if folder.resolve() != self.root.resolve() / name / str(version):
            raise BrokenModelError(f"{name}@{version}: its folder lies elsewhere; links are not followed")
        manifest = Manifest.parse(self._read_file(folder / MANIFEST_FILE, MAX_MANIFEST_BYTES))
        if (manifest.name, manifest.version) != (name, version):
            raise BrokenModelError(
                f"{MANIFEST_FILE}: is of {manifest.name}@{manifest.version}, found as {name}@{version}"
            )
        surplus = set(_listing(folder)) - set(manifest.files) - {MANIFEST_FILE}
        if surplus:
            raise BrokenModelError(f"{name}@{version}: {len(surplus)} files are not in the manifest")
        contents = {
            file: self._read_vouched(folder / file, limit, manifest.files[file])
            for file, limit in ((MODEL_FILE, MAX_MODEL_BYTES), (CARD_FILE, MAX_CARD_BYTES))
        }
        return VerifiedVersion(manifest, contents[MODEL_FILE], contents[CARD_FILE].decode("utf-8", "replace"))

    def publish(self, draft: Manifest, model: bytes, card: str) -> Manifest:
        """Make the next version visible, whole, and return its manifest; the draft's version and files are replaced.

        Raises:
            PublishError, BrokenModelError: the disk refused, or the draft breaks the contract; nothing became visible.
            RegistryError: the version is visible, and the history could not be written.
        """
        contents = {MODEL_FILE: model, CARD_FILE: card.encode()}
        digests = {file: FileDigest.of(content) for file, content in contents.items()}
        folder = self._folder(draft.name)
        staging = folder / f"{STAGING_PREFIX}{secrets.token_hex(8)}"
        try:
            folder.mkdir(parents=True, exist_ok=True)
            staging.mkdir()
            for file, content in contents.items():
                _write_synced(staging / file, content)
            manifest = self._make_visible(staging, replace(draft, files=digests))
        except OSError as error:
            raise PublishError(
                f"{draft.name}: {error.strerror or 'the disk refused'}; nothing was published"
            ) from error
        finally:
            shutil.rmtree(staging, ignore_errors=True)
        self._record(draft.name, "publish", None, manifest.version)
        return manifest

    def point_alias(self, name: str, alias: str, version: int) -> None:
        """Point an alias at a version that passes verification, atomically.

        Raises:
            RegistryError: the alias is not a name, or the disk refused.
            BrokenModelError: the version does not pass verification; the alias stays.
        """
        if not is_alias(alias):
            raise RegistryError("an alias is of lower-case letters, digits, '-' and '_', and not a number")
        self.read(name, version)
        folder = self._folder(name) / ALIASES_FOLDER
        before = self.aliases(name).get(alias)
        part = folder / f".{alias}-{secrets.token_hex(8)}"
        try:
            folder.mkdir(exist_ok=True)
            _write_synced(part, f"{version}\n".encode())
            part.replace(folder / alias)
            _sync_folder(folder)
        except OSError as error:
            with contextlib.suppress(OSError):
                part.unlink(missing_ok=True)
            raise RegistryError(f"{name}@{alias}: {error.strerror or 'the disk refused'}; it stays") from error
        self._record(name, f"alias {alias}", before, version)

    def fingerprint(self) -> tuple[tuple[str, int, int], ...]:
        """Changes whenever a version or an alias appears, moves or goes: one stat of two folders per model.

        Raises:
            RegistryError: the folder cannot be listed.
        """
        return tuple(
            (name, _modified(self.root / name), _modified(self.root / name / ALIASES_FOLDER)) for name in self.names()
        )

    def _folder(self, name: str) -> Path:
        if not is_name(name):
            raise RegistryError("a model name is of lower-case letters, digits, '-' and '_'")
        return self.root / name

    def _make_visible(self, staging: Path, draft: Manifest) -> Manifest:
        """Write the manifest last, sync, rename to the next number that is free."""
        folder = staging.parent
        version = max(self.versions(draft.name), default=0)
        while True:
            version += 1
            manifest = replace(draft, version=version)
            content = manifest.render()
            Manifest.parse(content)  # what could not be read back must not become visible
            _write_synced(staging / MANIFEST_FILE, content)
            _sync_folder(staging)
            try:
                # refuses a folder that is not empty, and a version never is
                staging.rename(folder / str(version))
            except OSError as error:
                if error.errno in _TAKEN:
                    continue
                raise
            _sync_folder(folder)
            _sync_folder(folder.parent)
            return manifest

    def _record(self, name: str, what: str, before: int | None, after: int) -> None:
        line = {
            "time": datetime.now(UTC).isoformat(timespec="seconds"),
            "who": _user(),
            "what": what,
            "from": before,
            "to": after,
        }
        try:
            descriptor = os.open(self._folder(name) / HISTORY_FILE, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o644)
            with os.fdopen(descriptor, "wb") as file:
                file.write((json.dumps(line) + "\n").encode())
                file.flush()
                os.fsync(file.fileno())
        except OSError as error:
            raise RegistryError(
                f"{name}: {what} of {after} is done, and {HISTORY_FILE} could not be written"
            ) from error

    def _read_vouched(self, path: Path, limit: int, digest: FileDigest) -> bytes:
        content = self._read_file(path, limit)
        found = FileDigest.of(content)
        if found != digest:
            what = f"{found.size} of {digest.size} bytes" if found.size != digest.size else "the sha256 differs"
            raise BrokenModelError(f"{path.name}: {what}: not the file that was published")
        return content

    def _read_file(self, path: Path, limit: int) -> bytes:
        """A regular file inside the registry, of at most ``limit`` bytes."""
        try:
            descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
            with os.fdopen(descriptor, "rb") as file:
                kind = os.fstat(file.fileno())
                if not stat.S_ISREG(kind.st_mode):
                    raise BrokenModelError(f"{path.name}: not a regular file")
                content = file.read(limit + 1)
        except OSError as error:
            raise BrokenModelError(f"{path.name}: {error.strerror or 'cannot be read'}") from error
        if len(content) > limit:
            raise BrokenModelError(f"{path.name}: more than {limit} bytes")
        return content


def _listing(folder: Path) -> list[str]:
    try:
        return [entry.name for entry in folder.iterdir()]
    except OSError as error:
        raise RegistryError(f"the registry cannot be listed: {error.strerror}") from error


def _is_folder(path: Path) -> bool:
    try:
        return stat.S_ISDIR(path.stat().st_mode)
    except OSError:
        return False


def _modified(folder: Path) -> int:
    try:
        return folder.stat().st_mtime_ns
    except OSError:
        return 0


def _numbers(versions: list[int]) -> str:
    return ", ".join(map(str, versions[-10:])) or "none"


def _user() -> str:
    try:
        return getpass.getuser()
    except (KeyError, OSError):  # a container's user without an entry in passwd
        return str(os.getuid())


def _write_synced(path: Path, content: bytes) -> None:
    with path.open("wb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())


def _sync_folder(folder: Path) -> None:
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
