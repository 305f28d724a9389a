"""Objects of one prefix of an S3-compatible bucket: bounded reads, conditional writes. The only user of obstore.

Credentials, region and endpoint come from the environment as for every S3 tool: AWS_ACCESS_KEY_ID, AWS_REGION,
AWS_ENDPOINT_URL, ... Methods raise the errors of ``FAILURES``. A missing object raises ``FileNotFoundError``, every
other failure, and a panic of the library too, ``StoreFailure`` with cause and cure (``service.storage.bucket_causes``).
"""

import contextlib
import os
import re
import secrets
import time
from collections.abc import Iterator
from datetime import timedelta
from typing import TYPE_CHECKING, Final, Self

import obstore
from obstore.exceptions import AlreadyExistsError, BaseError, PreconditionError
from obstore.store import S3Store

from service.errors import BrokenModelError, CazslError, RegistryError
from service.storage.bucket_causes import PANIC, UNREACHABLE, cause_of, code_of, fault_of_environment
from service.storage.survey import PROBE

if TYPE_CHECKING:  # names that only the library's stubs have
    from obstore import GetResult
    from obstore.store import S3Config

__all__ = ["FAILURES", "AlreadyExistsError", "Bucket", "StoreFailure", "reason"]
PATIENCE: Final = timedelta(seconds=10)
_BUCKET: Final = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,254}")
_PANICS: Final = "pyo3_runtime"  # the module of the library's panics, which derive from BaseException


class StoreFailure(Exception):  # noqa: N818 (it is the cause of an error of ours, and never leaves this package)
    """The store cannot be asked, or refused. The text is the cause in words, with its cure."""

    @property
    def is_outage(self) -> bool:
        """Return whether no request can succeed now."""
        return str(self).startswith(UNREACHABLE)


FAILURES: Final = (StoreFailure, FileNotFoundError)


class Bucket:
    """Objects below one prefix of a bucket. Keys are relative to the prefix."""

    def __init__(self, store: S3Store, address: str) -> None:
        self.address = address  # endpoint and location, unique for each bucket
        self._store = store
        self._fault = fault_of_environment()
        self._has_conditional_writes = False

    @classmethod
    def at(cls, location: str) -> Self:
        """Open the bucket and prefix of ``s3://bucket/prefix``. No request is sent yet.

        Raises:
            RegistryError: the location has no bucket, or the environment does not describe a store.
        """
        bucket, _, prefix = location.removeprefix("s3://").partition("/")
        if not _BUCKET.fullmatch(bucket) or not prefix.isprintable():
            raise RegistryError("registry: the location names no bucket; a registry in a bucket is s3://bucket/prefix")
        if not {"", ".", ".."}.isdisjoint(prefix.strip("/").split("/") if prefix else ()):
            raise RegistryError("registry: the prefix has an empty part, '.' or '..'; accepted is s3://bucket/prefix")
        endpoint = os.environ.get("AWS_ENDPOINT_URL_S3") or os.environ.get("AWS_ENDPOINT_URL") or ""
        options: S3Config = {"endpoint": endpoint} if endpoint else {}
        try:
            store = S3Store(  # sends nothing, and does not look at what it will send
                bucket,
                prefix=prefix.strip("/") or None,
                config=options,
                client_options={"timeout": PATIENCE, "allow_http": endpoint.startswith("http://")},
                retry_config={"max_retries": 2, "retry_timeout": PATIENCE},
            )
        except (BaseError, ValueError) as error:
            raise RegistryError(
                "registry: the bucket cannot be opened; check CAZSL_REGISTRY and the AWS_* environment variables"
            ) from error
        return cls(store, f"{endpoint} {location.rstrip('/')}")

    def folders(self, prefix: str = "") -> list[str]:
        """Return the names of the folders directly below a prefix."""
        return self.entries(prefix)[0]

    def files(self, prefix: str) -> list[str]:
        """Return the names of the objects directly below a prefix."""
        return self.entries(prefix)[1]

    def entries(self, prefix: str = "") -> tuple[list[str], list[str]]:
        """Return the names of the folders and of the objects directly below a prefix."""
        with self._asking():
            found = obstore.list_with_delimiter(self._store, prefix)
        return [_last(path) for path in found["common_prefixes"]], [_last(entry["path"]) for entry in found["objects"]]

    def get(self, key: str, limit: int) -> bytes:
        """Read an object, or raise ``BrokenModelError`` if it has more than ``limit`` bytes."""
        return self.get_tagged(key, limit)[0]

    def get_tagged(self, key: str, limit: int) -> tuple[bytes, str | None]:
        """Read an object and its entity tag, bounded as in ``get``."""
        with self._asking():
            result = obstore.get(self._store, key)
            return _bounded(result, _last(key), limit), result.meta["e_tag"]

    def tag(self, key: str) -> str | None:
        """Return the entity tag of an object, or None if there is no such object."""
        try:
            with self._asking():
                return obstore.head(self._store, key)["e_tag"]
        except FileNotFoundError:
            return None

    def put(self, key: str, content: bytes) -> None:
        """Create or replace an object."""
        with self._asking():
            obstore.put(self._store, key, content)

    def create(self, key: str, content: bytes) -> None:
        """Create an object, or raise ``AlreadyExistsError``."""
        with self._asking():
            obstore.put(self._store, key, content, mode="create")

    def replace(self, key: str, content: bytes, tag: str | None) -> bool:
        """Replace the object if it still has this tag, or create it if the tag is None. Return whether it was written.

        If the store's answer is lost, the retried request is refused although the first one succeeded. The object is
        therefore read and compared.
        """
        try:
            if tag is None:
                self.create(key, content)
            else:
                with self._asking():
                    obstore.put(self._store, key, content, mode={"e_tag": tag})
        except (AlreadyExistsError, PreconditionError):
            if self.holds(key, content):
                return True
            time.sleep(0.01)
            return False
        return True

    def holds(self, key: str, content: bytes) -> bool:
        """Return whether an object has these bytes."""
        try:
            return self.get(key, len(content)) == content
        except BrokenModelError:  # it has more
            return False

    def delete(self, key: str) -> None:
        """Delete an object, if it is there."""
        with self._asking():
            obstore.delete(self._store, key)

    def require_conditional_writes(self) -> None:
        """Test once, with a probe object, that the store supports conditional writes. Every promise rests on them.

        Raises:
            RegistryError: the store ignores conditions.
        """
        if self._has_conditional_writes:
            return
        key = f"{PROBE}{secrets.token_hex(8)}"
        try:
            self.create(key, b"first")
            supported = not self._creates_again(key) and not self.replace(key, b"third", '"0"')
        finally:
            self.delete(key)
        if not supported:
            raise RegistryError(
                "registry: the store does not support conditional writes (If-None-Match, If-Match), so writers could "
                "overwrite each other; no version or alias was written; use a store that supports them"
            )
        self._has_conditional_writes = True

    @contextlib.contextmanager
    def _asking(self) -> Iterator[None]:
        """Turn errors and panics of the library into ``StoreFailure``, except those that answer the request."""
        if self._fault is not None:
            raise StoreFailure(self._fault)
        try:
            yield
        except (AlreadyExistsError, PreconditionError, CazslError):
            raise
        except FileNotFoundError as error:
            code, with_body = code_of(error), "performing HEAD" not in str(error)
            if code == "NoSuchBucket" or (code is None and with_body):  # 404 does not say that the object is missing
                raise StoreFailure(cause_of(error)) from error
            raise
        except (BaseError, OSError, ValueError) as error:
            raise StoreFailure(cause_of(error)) from error
        except BaseException as error:
            if type(error).__module__ != _PANICS:
                raise
            raise StoreFailure(PANIC) from error

    def _creates_again(self, key: str) -> bool:
        try:
            self.create(key, b"second")
        except AlreadyExistsError:
            return False
        return True


def reason(error: Exception) -> str:
    """Return the cause of an error of ``FAILURES`` in words."""
    return "the object is missing" if isinstance(error, FileNotFoundError) else str(error)


def _last(path: str) -> str:
    return str(path).rstrip("/").rpartition("/")[2]


def _bounded(result: "GetResult", file: str, limit: int) -> bytes:
    """Read at most ``limit`` bytes of an object, even if it is larger than its metadata says."""
    parts, size = [], result.meta["size"]
    if size <= limit:
        size = 0
        for part in result.stream():
            size += len(part)
            parts.append(bytes(part))
            if size > limit:
                break
    if size > limit:
        raise BrokenModelError(f"{file}: more than {limit} bytes")
    return b"".join(parts)
