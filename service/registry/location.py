"""Location of a registry, a folder or ``s3://bucket/prefix``, and the keys that it trusts."""

import os
from pathlib import Path
from typing import Final

from service.errors import RegistryError
from service.files import read_file
from service.registry.registry import Registry
from service.registry.verification import MAX_MODEL_BYTES, Signatures
from service.storage.base import Storage

S3_SCHEME: Final = "s3://"


def open_registry(
    location: str,
    signatures: Signatures | None = None,
    max_model_bytes: int = MAX_MODEL_BYTES,
    cache: Path | None = None,
) -> Registry:
    """Open the registry at a location. No file is read yet.

    Raises:
        RegistryError: the location is not that of a registry, or a needed extra is not installed.
    """
    return Registry(_storage(location, cache), signatures, max_model_bytes)


def trusted_keys(paths: str) -> Signatures | None:
    """Return the check of signatures by these public keys, PEM files separated as in PATH. None for no keys.

    Raises:
        RegistryError: a key cannot be read, or a needed extra is not installed.
    """
    if not paths.strip():
        return None
    keys = tuple(Path(part.strip()) for part in paths.split(os.pathsep) if part.strip())
    if not keys:
        raise RegistryError(
            "CAZSL_REQUIRE_SIGNATURE: received no path; accepted are public keys in PEM files, or no text"
        )
    try:  # loaded only if signatures are required, because it takes 50 MiB of memory
        from service.registry.signing import TrustedKeys
    except ImportError as error:
        raise RegistryError("signatures need the extra 'signing': pip install 'cazsl[signing]'") from error
    for key in keys:
        try:
            if b"PUBLIC KEY" not in read_file(key):
                raise RegistryError(f"CAZSL_REQUIRE_SIGNATURE: trusted key {key.name}: not a public key in PEM format")
        except OSError as error:
            reason = f"cannot be read: {error.strerror}"
            raise RegistryError(f"CAZSL_REQUIRE_SIGNATURE: trusted key {key.name}: {reason}") from error
    return TrustedKeys(keys)


def _storage(location: str, cache: Path | None) -> Path | Storage:
    if location.startswith(S3_SCHEME):
        try:  # loaded only for buckets
            from service.storage.bucket_storage import BucketStorage
        except ImportError as error:
            raise RegistryError("a registry in a bucket needs the extra 's3': pip install 'cazsl[s3]'") from error
        return BucketStorage.at(location, cache)
    if "://" in location:
        raise RegistryError("registry: unknown kind of address; a registry is a folder or s3://bucket/prefix")
    return Path(location)
