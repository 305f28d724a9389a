"""What is checked of a version before anyone gets a byte of it: sizes, format, files, digests, signature.

Each file is read once, and what was compared is what is handed over.
"""

from dataclasses import dataclass
from typing import Final, Protocol

from service.errors import BrokenModelError
from service.model.manifest import CARD_FILE, MANIFEST_FILE, MODEL_FILE, FileDigest, Manifest
from service.storage.base import Storage

MAX_MANIFEST_BYTES: Final = 1 << 20
MAX_MODEL_BYTES: Final = 64 << 20
MAX_CARD_BYTES: Final = 1 << 20


@dataclass(frozen=True)
class VerifiedVersion:
    """A version whose bytes are those that its manifest vouches for."""

    manifest: Manifest
    model: bytes
    card: str
    files: dict[str, bytes]  # every file as it was read, the manifest among them
    signature: bytes | None


class Signatures(Protocol):
    """Whoever demands signatures; see ``service.registry.signing``."""

    def check(self, files: dict[str, bytes], signature: bytes | None) -> None:
        """Accept the bytes of a version.

        Raises:
            BrokenModelError: nobody who is trusted signed them.
        """
        ...


def verify(
    storage: Storage, name: str, version: int, max_model_bytes: int, signatures: Signatures | None
) -> VerifiedVersion:
    """Read every file of a version and accept it.

    Raises:
        BrokenModelError: names the file that is at fault, what was found and what was expected.
    """
    content = storage.read(name, version, MANIFEST_FILE, MAX_MANIFEST_BYTES)
    manifest = Manifest.parse(content)
    if (manifest.name, manifest.version) != (name, version):
        raise BrokenModelError(f"{MANIFEST_FILE}: is of {manifest.name}@{manifest.version}, found as {name}@{version}")
    surplus = set(storage.files(name, version)) - set(manifest.files) - {MANIFEST_FILE}
    if surplus:
        raise BrokenModelError(f"{name}@{version}: {len(surplus)} files are not in the manifest")
    files = {MANIFEST_FILE: content}
    for file, limit in ((MODEL_FILE, max_model_bytes), (CARD_FILE, MAX_CARD_BYTES)):
        files[file] = storage.read(name, version, file, limit)
        _compare(file, files[file], manifest.files[file])
    signature = storage.signature(name, version)
    if signatures is not None:
        signatures.check(files, signature)
    return VerifiedVersion(manifest, files[MODEL_FILE], files[CARD_FILE].decode("utf-8", "replace"), files, signature)


def _compare(file: str, content: bytes, expected: FileDigest) -> None:
    found = FileDigest.of(content)
    if found != expected:
        what = f"{found.size} of {expected.size} bytes" if found.size != expected.size else "the sha256 differs"
        raise BrokenModelError(f"{file}: {what}: not the file that was published")
