"""A cache of a bucket on the disk: it survives restarts and outages, and is verified like the bucket.

Files of a version never change, so they are downloaded once. ``Registry.read`` compares their digests in either case.
States and listings are kept, so that a service can start while the bucket is unreachable. A cache that cannot be
written only costs speed. Cached files that differ from their manifest are deleted.
"""

import contextlib
import json
import os
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from service.errors import BrokenModelError, RegistryError
from service.model.manifest import CARD_FILE, MANIFEST_FILE, MODEL_FILE, FileDigest, Manifest
from service.model.reference import is_name
from service.model.strict_json import read_json
from service.storage.disk import replace_whole

VERSION_FILES: Final = frozenset({MANIFEST_FILE, MODEL_FILE, CARD_FILE})
MODELS: Final = "models.json"
MAX_LISTING_BYTES: Final = 4 << 20
STATE: Final = "state.json"
SIGNATURE: Final = "signature"


@dataclass(frozen=True)
class Cache:
    """Copies of a bucket's objects in one folder, which no other program writes."""

    root: Path

    def models(self) -> list[str] | None:
        """Return the last listing of models, or None if there is none."""
        try:
            names = read_json((self.root / MODELS).read_bytes(), MAX_LISTING_BYTES)
        except (OSError, ValueError):
            return None
        return [name for name in names if isinstance(name, str) and is_name(name)] if isinstance(names, list) else None

    def keep_models(self, names: list[str]) -> None:
        """Store a listing of models."""
        self._write(self.root / MODELS, json.dumps(names).encode())

    def state(self, name: str) -> bytes | None:
        """Return the last state of a model as it was read, or None if there is none."""
        with contextlib.suppress(OSError):
            return (self.root / name / STATE).read_bytes()
        return None

    def keep_state(self, name: str, content: bytes) -> None:
        """Store the state of a model as it was read."""
        self._write(self.root / name / STATE, content)

    def has(self, name: str, version: int) -> bool:
        """Return whether every file of a version is cached."""
        return set(self.files(name, version)) == VERSION_FILES

    def files(self, name: str, version: int) -> list[str]:
        """Return the names of the cached files of a version."""
        with contextlib.suppress(OSError):
            entries = os.listdir(self.root / name / str(version))  # noqa: PTH208 (cheaper than Path objects)
            return [entry for entry in entries if entry in VERSION_FILES]
        return []

    def read(self, name: str, version: int, file: str, limit: int) -> bytes | None:
        """Read a cached file of a version, or return None.

        A file that differs from the manifest beside it is deleted with its version.
        """
        try:
            with (self.root / name / str(version) / file).open("rb") as opened:
                content = opened.read(limit + 1)
            if len(content) <= limit and self._matches_manifest(name, version, file, content):
                return content
        except OSError:
            return None
        self.forget(name, version)
        return None

    def keep(self, name: str, version: int, file: str, content: bytes) -> None:
        """Store a file of a version."""
        if file in VERSION_FILES:
            self._write(self.root / name / str(version) / file, content)

    def signature(self, name: str, version: int) -> bytes | None:
        """Return the last signature of a version, or None if there is none."""
        with contextlib.suppress(OSError):
            return (self.root / name / f"{version}.{SIGNATURE}").read_bytes()
        return None

    def keep_signature(self, name: str, version: int, content: bytes) -> None:
        """Store the signature of a version."""
        self._write(self.root / name / f"{version}.{SIGNATURE}", content)

    def forget(self, name: str, version: int) -> None:
        """Delete the cached files of a version."""
        shutil.rmtree(self.root / name / str(version), ignore_errors=True)

    def _matches_manifest(self, name: str, version: int, file: str, content: bytes) -> bool:
        try:
            if file == MANIFEST_FILE:
                Manifest.parse(content)
                return True
            manifest = Manifest.parse((self.root / name / str(version) / MANIFEST_FILE).read_bytes())
        except BrokenModelError:
            return False
        return manifest.files.get(file) == FileDigest.of(content)

    def _write(self, path: Path, content: bytes) -> None:
        """Replace a file as a whole. If the disk refuses, the next reader downloads it again."""
        with contextlib.suppress(OSError):
            if path.exists() and path.read_bytes() == content:
                return
            path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
            replace_whole(path, content)


def cache_folder() -> Path:
    """Return the folder for caches: CAZSL_CACHE, or .cache/cazsl in the home of the user.

    Raises:
        RegistryError: the user has no home and the variable is not set.
    """
    named = os.environ.get("CAZSL_CACHE")
    try:
        return Path(named) if named else Path.home() / ".cache" / "cazsl"
    except RuntimeError as error:  # the user has no entry in passwd, as in containers
        raise RegistryError(
            "the cache of the bucket has no folder: this user has no home; set CAZSL_CACHE to a folder of its own"
        ) from error
