"""A registry in a bucket of any S3-compatible store that has conditional writes.

    <name>/<version>/model.onnx  card.md  manifest.json    immutable, created once
    <name>/state.json                                      versions, aliases, spent numbers, the last event
    <name>/history/<number>.json                           one object per event, created once
    <name>/signatures/<version>                            a detached signature, where there is one

A bucket has no rename, so the order of writes and conditional writes take its place. Content is created first:
creating the model file claims the number. The manifest follows. Then ``state.json`` is replaced on the condition that
no other writer replaced it. That one write makes a version visible, moves an alias or removes a version. It carries
the event, so no event is lost: if its writer dies, the next writer adds it to the history. A version that no state
names is invisible. Versions and states that were read are cached: see ``service.storage.bucket_cache``.
"""

import json
import os
import secrets
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, Self

from service.errors import BrokenModelError, ConflictError, PublishError, RegistryError
from service.model.manifest import CARD_FILE, MANIFEST_FILE, MODEL_FILE, FileDigest
from service.model.reference import is_name, parse_version
from service.storage.base import MAX_HISTORY_BYTES, MAX_SIGNATURE_BYTES, Decision, RegistryFinding
from service.storage.bucket import FAILURES, AlreadyExistsError, Bucket, reason
from service.storage.bucket_cache import Cache
from service.storage.history import PUBLISH, REMOVE, SIGN, Event, History, ModelState, current_user

STATE_FILE: Final = "state.json"
HISTORY: Final = "history"
SIGNATURES: Final = "signatures"
MAX_STATE_BYTES: Final = 4 << 20
MAX_EVENT_BYTES: Final = 64 << 10
ATTEMPTS: Final = 50  # to make one change while other writers win each race


@dataclass(frozen=True)
class _StateFile:
    """The content of ``state.json``: the state, the number of events that led to it, and the last event."""

    state: ModelState = field(default_factory=ModelState)
    generation: int = 0
    event: bytes = b""

    @classmethod
    def parse(cls, content: bytes) -> Self:
        """Parse the JSON document, or raise ``BrokenModelError``."""
        try:
            document = json.loads(content)
            state = ModelState(
                frozenset(map(int, document["versions"])),
                {str(alias): int(version) for alias, version in document["aliases"].items()},
                frozenset(map(int, document["removed"])),
            )
            return cls(state, int(document["generation"]), str(document["event"]).encode())
        except (ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
            raise BrokenModelError(f"{STATE_FILE}: not the state of a model; restore it from a backup") from error

    def render(self) -> bytes:
        """Render the JSON document."""
        document = {
            "versions": sorted(self.state.versions),
            "aliases": dict(sorted(self.state.aliases.items())),
            "removed": sorted(self.state.removed),
            "generation": self.generation,
            "event": self.event.decode(),
            "write": secrets.token_hex(8),  # makes the writes of two clients differ even if their content is equal
        }
        return json.dumps(document, indent=2).encode() + b"\n"


class BucketStorage:
    """See ``service.storage.base.Storage``."""

    def __init__(self, bucket: Bucket, cache: Cache) -> None:
        self._bucket = bucket
        self._cache = cache

    @classmethod
    def at(cls, location: str, cache: Path | None = None) -> Self:
        """Open the storage at ``s3://bucket/prefix``. The cache is in this folder, or CAZSL_CACHE, or ~/.cache/cazsl.

        Raises:
            RegistryError: the location names no bucket, the environment describes no store, or the cache has no folder.
        """
        bucket = Bucket.at(location)
        return cls(bucket, Cache((cache or _cache_folder()) / FileDigest.of(bucket.address.encode()).sha256[:32]))

    def models(self) -> list[str]:
        """See ``Storage.models``. If the store cannot be reached, the cached listing is returned."""
        try:
            found = self._bucket.folders()
        except FAILURES as error:
            if (known := self._cache.models()) is None:
                raise RegistryError(f"the registry cannot be listed: {reason(error)}") from error
            return known
        names = sorted(filter(is_name, found))
        self._cache.keep_models(names)
        return names

    def state(self, name: str) -> ModelState:
        """See ``Storage.state``. If the store cannot be reached, the cached state is returned."""
        try:
            content = self._bucket.get(f"{name}/{STATE_FILE}", MAX_STATE_BYTES)
        except FileNotFoundError:
            return ModelState()
        except FAILURES as error:
            if (known := self._cache.state(name)) is None:
                raise RegistryError(f"{name}: the state cannot be read: {reason(error)}") from error
            return _StateFile.parse(known).state
        found = _StateFile.parse(content)
        self._cache.keep_state(name, content)
        return found.state

    def files(self, name: str, version: int) -> list[str]:
        """See ``Storage.files``."""
        if self._cache.has(name, version):
            return self._cache.files(name, version)
        try:
            return self._bucket.files(f"{name}/{version}/") + self._bucket.folders(f"{name}/{version}/")
        except FAILURES as error:
            raise BrokenModelError(f"{name}@{version}: {reason(error)}") from error

    def read(self, name: str, version: int, file: str, limit: int) -> bytes:
        """See ``Storage.read``. The cache is read first, and verified like the store."""
        if file == MANIFEST_FILE and version not in self.state(name).versions:
            raise BrokenModelError(f"{file}: there is no version {name}@{version}")
        if (known := self._cache.read(name, version, file, limit)) is not None:
            return known
        try:
            content = self._bucket.get(f"{name}/{version}/{file}", limit)
        except FileNotFoundError as error:
            raise BrokenModelError(f"{file}: No such file") from error
        except FAILURES as error:
            raise BrokenModelError(f"{file}: {reason(error)}") from error
        self._cache.keep(name, version, file, content)
        return content

    def publish(
        self, name: str, files: Mapping[str, bytes], manifest: Callable[[int], bytes], number: int | None = None
    ) -> int:
        """See ``Storage.publish``."""
        try:
            self._bucket.require_conditional_writes()
            version, content = self._claim(name, files, manifest, number)
        except FAILURES as error:
            raise PublishError(f"{name}: {reason(error)}; no version was published") from error

        def decide(state: ModelState) -> Event:
            """Make the version visible, unless its number was used in the meantime."""
            state.free_number(version)
            return Event(PUBLISH, None, version, manifest=FileDigest.of(content).sha256)

        self.commit(name, decide)
        return version

    def commit(self, name: str, decide: Decision) -> Event:
        """See ``Storage.commit``."""
        try:
            self._bucket.require_conditional_writes()
            event = self._commit(name, decide)
            if event.what == REMOVE and event.before is not None:
                self._delete(name, event.before)
        except FAILURES as error:
            raise RegistryError(
                f"{name}: {reason(error)}; the change may have been made: see `cazsl models history {name}`"
            ) from error
        return event

    def history(self, name: str) -> History:
        """See ``Storage.history``."""
        try:
            found = self._state_file(name)[0]
            lines = [
                self._bucket.get(_event_key(name, number), MAX_EVENT_BYTES) for number in range(1, found.generation)
            ]
        except FAILURES as error:
            raise RegistryError(f"{name}: the history cannot be read: {reason(error)}") from error
        if sum(map(len, lines)) > MAX_HISTORY_BYTES:
            raise RegistryError(f"{name}: the history is larger than {MAX_HISTORY_BYTES} bytes")
        return History.parse(b"".join([*lines, found.event]))

    def signature(self, name: str, version: int) -> bytes | None:
        """See ``Storage.signature``. If the store cannot be reached, the cached signature is returned."""
        try:
            content = self._bucket.get(f"{name}/{SIGNATURES}/{version}", MAX_SIGNATURE_BYTES)
        except FileNotFoundError:
            return None
        except FAILURES:
            return self._cache.signature(name, version)
        self._cache.keep_signature(name, version, content)
        return content

    def sign(self, name: str, version: int, signature: bytes) -> None:
        """See ``Storage.sign``. The state is rewritten, so that the fingerprint changes."""
        try:
            self._bucket.put(f"{name}/{SIGNATURES}/{version}", signature)
            self._commit(name, lambda _: Event(SIGN, None, version))
        except FAILURES as error:
            raise RegistryError(f"{name}@{version}: {reason(error)}; the version was not signed") from error

    def fingerprint(self) -> Hashable:
        """See ``Storage.fingerprint``. Sends one listing, and one HEAD request per model."""
        try:
            names = sorted(filter(is_name, self._bucket.folders()))
            return tuple((name, self._bucket.tag(f"{name}/{STATE_FILE}")) for name in names)
        except FAILURES as error:
            raise RegistryError(f"the registry cannot be listed: {reason(error)}") from error

    def survey(self) -> Sequence[RegistryFinding]:
        """See ``Storage.survey``. Finds versions that no state names."""
        advice = (
            "a writer was interrupted, or is still writing; it only takes space, and can be deleted once no one writes"
        )
        found = []
        try:
            for name in self.models():
                state = self.state(name)
                for folder in self._bucket.folders(f"{name}/"):
                    version = parse_version(folder)
                    if version is not None and version not in state.versions | state.removed:
                        found.append(RegistryFinding(f"{name}/{version}", "is incomplete", advice, severe=False))
        except FAILURES as error:
            raise RegistryError(f"the registry cannot be listed: {reason(error)}") from error
        return found

    def _claim(
        self, name: str, files: Mapping[str, bytes], manifest: Callable[[int], bytes], number: int | None
    ) -> tuple[int, bytes]:
        """Create the files of a version under an unused number, the manifest last. Return number and manifest."""
        version = self._state_file(name)[0].state.free_number(number)
        while True:
            content = manifest(version)
            try:
                for file in (MODEL_FILE, CARD_FILE):
                    self._bucket.create(f"{name}/{version}/{file}", files[file])
                self._bucket.create(f"{name}/{version}/{MANIFEST_FILE}", content)
            except AlreadyExistsError as error:
                if number is not None:
                    raise ConflictError(
                        f"{name}: version {number} exists, or is being published; choose another number"
                    ) from error
                version += 1
            else:
                return version, content

    def _commit(self, name: str, decide: Decision) -> Event:
        """Replace the state if it is still the one that ``decide`` saw. Otherwise decide again."""
        for _ in range(ATTEMPTS):
            found, tag = self._state_file(name)
            self._record(name, found)
            event = decide(found.state).stamped(current_user(), FileDigest.of(found.event).sha256)
            line = event.render()
            after = _StateFile(found.state.after(event), found.generation + 1, line)
            if self._bucket.replace(f"{name}/{STATE_FILE}", after.render(), tag):
                self._record(name, after)
                return event
        raise RegistryError(f"{name}: other writers changed it {ATTEMPTS} times in a row; try again")

    def _record(self, name: str, found: _StateFile) -> None:
        """Write the last event into the history, unless another writer did."""
        if found.generation:
            try:
                self._bucket.create(_event_key(name, found.generation), found.event)
            except AlreadyExistsError:
                return

    def _state_file(self, name: str) -> tuple[_StateFile, str | None]:
        try:
            content, tag = self._bucket.get_tagged(f"{name}/{STATE_FILE}", MAX_STATE_BYTES)
        except FileNotFoundError:
            return _StateFile(), None
        return _StateFile.parse(content), tag

    def _delete(self, name: str, version: int) -> None:
        """Delete the files of a removed version, except its manifest."""
        for key in (
            f"{name}/{version}/{MODEL_FILE}",
            f"{name}/{version}/{CARD_FILE}",
            f"{name}/{SIGNATURES}/{version}",
        ):
            self._bucket.delete(key)
        self._cache.forget(name, version)


def _event_key(name: str, number: int) -> str:
    return f"{name}/{HISTORY}/{number:09d}.json"


def _cache_folder() -> Path:
    named = os.environ.get("CAZSL_CACHE")
    try:
        return Path(named) if named else Path.home() / ".cache" / "cazsl"
    except RuntimeError as error:  # the user has no entry in passwd, as in containers
        raise RegistryError(
            "the cache of the bucket has no folder: this user has no home; set CAZSL_CACHE to a folder of its own"
        ) from error
