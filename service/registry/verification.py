"""Verification of a version before any byte of it is used: sizes, format, tensors, files, digests, signature.

Each file is read once. The bytes that were compared are the bytes that are returned.
"""

from dataclasses import dataclass
from typing import Final, Protocol

from service.errors import BrokenModelError
from service.model.domain import Domain
from service.model.manifest import (
    CARD_FILE,
    MANIFEST_FILE,
    MAX_MANIFEST_BYTES,
    MODEL_FILE,
    FileDigest,
    Manifest,
)
from service.storage.base import Storage

MAX_MODEL_BYTES: Final = 64 << 20
MAX_CARD_BYTES: Final = 1 << 20


@dataclass(frozen=True)
class VerifiedVersion:
    """A version whose bytes have the digests of its manifest."""

    manifest: Manifest
    model: bytes
    card: str
    files: dict[str, bytes]  # every file as it was read, with the manifest
    signature: bytes | None


class Signatures(Protocol):
    """Verify signatures. ``service.registry.signing.TrustedKeys`` implements this protocol."""

    def check(self, files: dict[str, bytes], signature: bytes | None) -> None:
        """Accept the bytes of a version.

        Raises:
            BrokenModelError: no trusted key signed them.
        """
        ...


@dataclass(frozen=True)
class Requirements:
    """Requirements of a registry for its versions.

    Attributes:
        domain: domain whose tensors a version must declare.
        signatures: check of signatures. None: signatures are not required.
        max_model_bytes: maximum bytes of a model file.
    """

    domain: Domain
    signatures: Signatures | None
    max_model_bytes: int


def verify(storage: Storage, name: str, version: int, required: Requirements) -> VerifiedVersion:
    """Read every file of a version and accept it.

    Raises:
        BrokenModelError: the version fails. The message names the file, the value found and the value expected.
    """
    content = storage.read(name, version, MANIFEST_FILE, MAX_MANIFEST_BYTES)
    manifest = parse_manifest(content, required.domain)
    if (manifest.name, manifest.version) != (name, version):
        raise BrokenModelError(f"{MANIFEST_FILE}: is of {manifest.name}@{manifest.version}, found as {name}@{version}")
    surplus = set(storage.files(name, version)) - set(manifest.files) - {MANIFEST_FILE}
    if surplus:
        raise BrokenModelError(f"{name}@{version}: {len(surplus)} files are not in the manifest")
    files = {MANIFEST_FILE: content}
    for file, limit in ((MODEL_FILE, required.max_model_bytes), (CARD_FILE, MAX_CARD_BYTES)):
        files[file] = storage.read(name, version, file, limit)
        _compare(file, files[file], manifest.files[file])
    signature = storage.signature(name, version)
    if required.signatures is not None:
        required.signatures.check(files, signature)
    return VerifiedVersion(manifest, files[MODEL_FILE], files[CARD_FILE].decode("utf-8", "replace"), files, signature)


def parse_manifest(content: bytes, domain: Domain) -> Manifest:
    """Read a manifest and check that its tensors are those of the domain.

    Raises:
        BrokenModelError: it is not a manifest, or declares other tensors.
    """
    manifest = Manifest.parse(content)
    if manifest.inputs != domain.inputs(manifest.context_kind):
        raise BrokenModelError(f"{MANIFEST_FILE}: inputs: not the tensors of this context kind")
    if manifest.outputs not in domain.outputs(manifest.context_kind, manifest.format):
        raise BrokenModelError(f"{MANIFEST_FILE}: outputs: not the tensors of the contract")
    return manifest


def _compare(file: str, content: bytes, expected: FileDigest) -> None:
    found = FileDigest.of(content)
    if found != expected:
        fault = f"{found.size} of {expected.size} bytes" if found.size != expected.size else "the sha256 differs"
        raise BrokenModelError(f"{file}: {fault}: not the file that was published")
