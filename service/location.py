"""A registry from the text that names it: a folder, or ``s3://bucket/prefix``."""

from pathlib import Path
from typing import Final

from service.errors import RegistryError
from service.registry import MAX_MODEL_BYTES, Registry, Signatures
from service.storage import Storage

S3_SCHEME: Final = "s3://"


def open_registry(
    location: str, signatures: Signatures | None = None, max_model_bytes: int = MAX_MODEL_BYTES
) -> Registry:
    """The registry at a location; nothing is read yet.

    Raises:
        RegistryError: the location cannot be one, or what it needs is not installed.
    """
    return Registry(_storage(location), signatures, max_model_bytes)


def _storage(location: str) -> Path | Storage:
    if location.startswith(S3_SCHEME):
        try:  # a dependency that only buckets need
            from service.object_store import ObjectStorage
        except ImportError as error:
            raise RegistryError("a registry in a bucket needs the extra 's3': pip install 'cazsl[s3]'") from error
        return ObjectStorage.at(location)
    if "://" in location:
        raise RegistryError("a registry is a folder or s3://bucket/prefix")
    return Path(location)
