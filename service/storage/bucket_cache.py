"""What was read from a bucket, kept on a disk: survives restarts and outages, and is believed no more than the bucket.

Files of a version never change, so they are asked for once; whoever reads them compares their digests, wherever they
came from (``Registry.read``). States and listings are kept to know what to serve when the bucket cannot be reached. A
cache that cannot be written costs speed and nothing else; one that holds wrong bytes is emptied of them.
"""

import contextlib
import json
import os
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from service.errors import BrokenModelError
from service.model.manifest import CARD_FILE, MANIFEST_FILE, MODEL_FILE, FileDigest, Manifest
from service.model.reference import is_name
from service.storage.disk import replace_whole

WHOLE: Final = frozenset({MANIFEST_FILE, MODEL_FILE, CARD_FILE})
MODELS: Final = "models.json"
STATE: Final = "state.json"
SIGNATURE: Final = "signature"


@dataclass(frozen=True)
class Cache:
    """A folder of our own."""

    root: Path

    def models(self) -> list[str] | None:
        """The models that were last listed, if ever any were."""
        try:
            names = json.loads((self.root / MODELS).read_bytes())
        except (OSError, ValueError):
            return None
        return [name for name in names if isinstance(name, str) and is_name(name)] if isinstance(names, list) else None

    def keep_models(self, names: list[str]) -> None:
        """Remember a listing."""
        self._write(self.root / MODELS, json.dumps(names).encode())

    def state(self, name: str) -> bytes | None:
        """The state that was last read."""
        with contextlib.suppress(OSError):
            return (self.root / name / STATE).read_bytes()
        return None

    def keep_state(self, name: str, content: bytes) -> None:
        """Remember a state."""
        self._write(self.root / name / STATE, content)

    def has(self, name: str, version: int) -> bool:
        """Whether every file of a version is here."""
        return set(self.files(name, version)) == WHOLE

    def files(self, name: str, version: int) -> list[str]:
        """The files of a version that are here."""
        with contextlib.suppress(OSError):
            return [entry for entry in os.listdir(self.root / name / str(version)) if entry in WHOLE]  # noqa: PTH208
        return []

    def read(self, name: str, version: int, file: str, limit: int) -> bytes | None:
        """A file of a version, if it is here and what the manifest beside it vouches for."""
        try:
            with (self.root / name / str(version) / file).open("rb") as opened:
                content = opened.read(limit + 1)
            if len(content) <= limit and self._vouched(name, version, file, content):
                return content
        except OSError:
            return None
        self.forget(name, version)
        return None

    def keep(self, name: str, version: int, file: str, content: bytes) -> None:
        """Remember a file of a version."""
        if file in WHOLE:
            self._write(self.root / name / str(version) / file, content)

    def signature(self, name: str, version: int) -> bytes | None:
        """The signature that was last read."""
        with contextlib.suppress(OSError):
            return (self.root / name / f"{version}.{SIGNATURE}").read_bytes()
        return None

    def keep_signature(self, name: str, version: int, content: bytes) -> None:
        """Remember a signature."""
        self._write(self.root / name / f"{version}.{SIGNATURE}", content)

    def forget(self, name: str, version: int) -> None:
        """Let go of a version."""
        shutil.rmtree(self.root / name / str(version), ignore_errors=True)

    def _vouched(self, name: str, version: int, file: str, content: bytes) -> bool:
        try:
            if file == MANIFEST_FILE:
                Manifest.parse(content)
                return True
            manifest = Manifest.parse((self.root / name / str(version) / MANIFEST_FILE).read_bytes())
        except BrokenModelError:
            return False
        return manifest.files.get(file) == FileDigest.of(content)

    def _write(self, path: Path, content: bytes) -> None:
        """Replace a file whole; a disk that refuses costs the next reader a download."""
        with contextlib.suppress(OSError):
            if path.exists() and path.read_bytes() == content:
                return
            path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
            replace_whole(path, content)
