"""Objects of one prefix of an S3-compatible bucket: bounded reads, conditional writes. The only user of obstore.

Credentials, region and endpoint come from the environment as for every S3 tool: AWS_ACCESS_KEY_ID, AWS_REGION,
AWS_ENDPOINT_URL, ... Methods raise what ``FAILURES`` lists, and ``FileNotFoundError`` for what is not there.
"""

import os
import secrets
import time
from datetime import timedelta
from typing import TYPE_CHECKING, Final, Self

import obstore
from obstore.exceptions import AlreadyExistsError, BaseError, PreconditionError
from obstore.store import S3Store

from service.errors import BrokenModelError, RegistryError

if TYPE_CHECKING:  # names that only the library's stubs have
    from obstore import GetResult
    from obstore.store import S3Config

__all__ = ["FAILURES", "AlreadyExistsError", "Bucket", "reason"]
PATIENCE: Final = timedelta(seconds=10)
FAILURES: Final = (BaseError, OSError)


class Bucket:
    """What lies below one prefix; keys are relative to it."""

    def __init__(self, store: S3Store, address: str) -> None:
        self.address = address  # endpoint and location: tells one from another
        self._store = store
        self._conditions_hold = False

    @classmethod
    def at(cls, location: str) -> Self:
        """The bucket and prefix of ``s3://bucket/prefix``; nothing is asked yet.

        Raises:
            RegistryError: the location or the environment cannot be one.
        """
        bucket, _, prefix = location.removeprefix("s3://").partition("/")
        if not bucket:
            raise RegistryError("a registry in a bucket is s3://bucket/prefix")
        endpoint = os.environ.get("AWS_ENDPOINT_URL_S3") or os.environ.get("AWS_ENDPOINT_URL") or ""
        options: S3Config = {"endpoint": endpoint} if endpoint else {}
        try:
            store = S3Store(
                bucket,
                prefix=prefix.strip("/") or None,
                config=options,
                client_options={"timeout": PATIENCE, "allow_http": endpoint.startswith("http://")},
                retry_config={"max_retries": 2, "retry_timeout": PATIENCE},
            )
        except (BaseError, ValueError) as error:
            raise RegistryError("the bucket cannot be used: see CAZSL_REGISTRY and AWS_* in the environment") from error
        return cls(store, f"{endpoint} {location.rstrip('/')}")

    def folders(self, prefix: str = "") -> list[str]:
        """The names that go on below a prefix."""
        found = obstore.list_with_delimiter(self._store, prefix)["common_prefixes"]
        return [_last(path) for path in found]

    def files(self, prefix: str) -> list[str]:
        """The names that end below a prefix."""
        return [_last(entry["path"]) for entry in obstore.list_with_delimiter(self._store, prefix)["objects"]]

    def get(self, key: str, limit: int) -> bytes:
        """An object of at most ``limit`` bytes, or ``BrokenModelError``."""
        return self.get_tagged(key, limit)[0]

    def get_tagged(self, key: str, limit: int) -> tuple[bytes, str | None]:
        """An object and the tag of what it is now."""
        result = obstore.get(self._store, key)
        return _bounded(result, _last(key), limit), result.meta["e_tag"]

    def tag(self, key: str) -> str | None:
        """The tag of what an object is now, None where there is none."""
        try:
            return obstore.head(self._store, key)["e_tag"]
        except FileNotFoundError:
            return None

    def put(self, key: str, content: bytes) -> None:
        """Create or replace an object."""
        obstore.put(self._store, key, content)

    def create(self, key: str, content: bytes) -> None:
        """Create an object, or raise ``AlreadyExistsError``."""
        obstore.put(self._store, key, content, mode="create")

    def replace(self, key: str, content: bytes, tag: str | None) -> bool:
        """Replace the object of this tag, or create it where there was none; whether it is ours now.

        An answer that was lost on the way looks like a refusal: the object is then read to tell.
        """
        try:
            if tag is None:
                self.create(key, content)
            else:
                obstore.put(self._store, key, content, mode={"e_tag": tag})
        except (AlreadyExistsError, PreconditionError):
            if self.get(key, len(content) + (4 << 20)) == content:
                return True
            time.sleep(0.01)
            return False
        return True

    def delete(self, key: str) -> None:
        """Delete an object, if it is there."""
        obstore.delete(self._store, key)

    def must_hold_conditions(self) -> None:
        """Refuse a store that does not heed conditions: everything promised rests on them.

        Raises:
            RegistryError: it does not.
        """
        if self._conditions_hold:
            return
        key = f"probe-{secrets.token_hex(8)}"
        try:
            self.create(key, b"first")
            heeded = not self._creates_again(key) and not self.replace(key, b"third", '"0"')
        finally:
            self.delete(key)
        if not heeded:
            raise RegistryError(
                "this store does not heed conditional writes (If-None-Match, If-Match); nothing was written"
            )
        self._conditions_hold = True

    def _creates_again(self, key: str) -> bool:
        try:
            self.create(key, b"second")
        except AlreadyExistsError:
            return False
        return True


def reason(error: Exception) -> str:
    """What went wrong, without addresses of anybody's network."""
    known = {
        "PermissionDeniedError": "the right is missing",
        "UnauthenticatedError": "credentials are refused",
    }
    return known.get(type(error).__name__, "the store cannot be reached or refused")


def _last(path: str) -> str:
    return str(path).rstrip("/").rpartition("/")[2]


def _bounded(result: "GetResult", file: str, limit: int) -> bytes:
    """The bytes of an object, never more than a limit, whatever size it claims."""
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
