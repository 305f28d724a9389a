"""A registry in a bucket of any S3-compatible store that has conditional writes.

    <name>/<version>/model.onnx  card.md  manifest.json    immutable, created once
    <name>/state.json                                      versions, aliases, spent numbers, the last event
    <name>/history/<number>.json                           one object per event, created once
    <name>/signatures/<version>                            a detached signature, where there is one

There is no rename, so order and conditions do its work. Content is created first (a number is claimed by creating its
model file), then the manifest, and at last ``state.json`` is replaced on condition that nobody else replaced it: that
one write makes a version visible, moves an alias or removes a version, and it carries the event, so that an event is
never lost: whoever comes next writes it into the history if its writer died first. What no state names is not there.

Credentials, region and endpoint come from the environment as for every S3 tool: AWS_ACCESS_KEY_ID, AWS_REGION,
AWS_ENDPOINT_URL, ... The versions that were read, and the states, are kept in a cache: see ``service.storage.bucket_cache``.
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
from service.storage.base import MAX_HISTORY_BYTES, MAX_SIGNATURE_BYTES, Decision, Finding
from service.storage.bucket import FAILURES, AlreadyExistsError, Bucket, reason
from service.storage.bucket_cache import Cache
from service.storage.history import PUBLISH, REMOVE, SIGN, Event, History, ModelState, user

STATE_FILE: Final = "state.json"
HISTORY: Final = "history"
SIGNATURES: Final = "signatures"
MAX_STATE_BYTES: Final = 4 << 20
MAX_EVENT_BYTES: Final = 64 << 10
ATTEMPTS: Final = 50  # at a change that others keep overtaking


@dataclass(frozen=True)
class _StateFile:
    """``state.json``: the state, how many events led to it, and the last of them."""

    state: ModelState = field(default_factory=ModelState)
    generation: int = 0
    event: bytes = b""

    @classmethod
    def parse(cls, content: bytes) -> Self:
        """Read it, or raise ``BrokenModelError``."""
        try:
            document = json.loads(content)
            state = ModelState(
                frozenset(map(int, document["versions"])),
                {str(alias): int(version) for alias, version in document["aliases"].items()},
                frozenset(map(int, document["removed"])),
            )
            return cls(state, int(document["generation"]), str(document["event"]).encode())
        except (ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
            raise BrokenModelError(f"{STATE_FILE}: not a state") from error

    def render(self) -> bytes:
        """One JSON document."""
        document = {
            "versions": sorted(self.state.versions),
            "aliases": dict(sorted(self.state.aliases.items())),
            "removed": sorted(self.state.removed),
            "generation": self.generation,
            "event": self.event.decode(),
            "write": secrets.token_hex(8),  # tells this write from one of another's that says the same
        }
        return json.dumps(document, indent=2).encode() + b"\n"


class ObjectStorage:
    """See ``service.storage.base.Storage``."""

    def __init__(self, bucket: Bucket, cache: Cache) -> None:
        self._bucket = bucket
        self._cache = cache

    @classmethod
    def at(cls, location: str, cache: Path | None = None) -> Self:
        """The storage at ``s3://bucket/prefix``, with its cache in this folder, CAZSL_CACHE or the user's own.

        Raises:
            RegistryError: the location or the environment cannot be one.
        """
        bucket = Bucket.at(location)
        return cls(bucket, Cache((cache or _cache_folder()) / FileDigest.of(bucket.address.encode()).sha256[:32]))

    def models(self) -> list[str]:
        """See ``Storage.models``; what the cache knows where the store cannot be reached."""
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
        """See ``Storage.state``; what the cache knows where the store cannot be reached."""
        try:
            content = self._bucket.get(f"{name}/{STATE_FILE}", MAX_STATE_BYTES)
        except FileNotFoundError:
            return ModelState()
        except FAILURES as error:
            if (known := self._cache.state(name)) is None:
                raise RegistryError(f"{name}: the store cannot be reached: {reason(error)}") from error
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
        """See ``Storage.read``; the cache is asked first, and believed no more than the store."""
        if file == MANIFEST_FILE and version not in self.state(name).versions:
            raise BrokenModelError(f"{file}: {name}@{version} is not there")
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
            self._bucket.must_hold_conditions()
            version, content = self._claim(name, files, manifest, number)
        except FAILURES as error:
            raise PublishError(f"{name}: {reason(error)}; nothing was published") from error

        def decide(state: ModelState) -> Event:
            """Visible from now on, unless the number was spent in the meantime."""
            state.free(version)
            return Event(PUBLISH, None, version, manifest=FileDigest.of(content).sha256)

        self.commit(name, decide)
        return version

    def commit(self, name: str, decide: Decision) -> Event:
        """See ``Storage.commit``."""
        try:
            self._bucket.must_hold_conditions()
            event = self._commit(name, decide)
            if event.what == REMOVE and event.before is not None:
                self._delete(name, event.before)
        except FAILURES as error:
            raise RegistryError(f"{name}: {reason(error)}; look at the history for whether it was done") from error
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
        """See ``Storage.signature``; what the cache knows where the store cannot be reached."""
        try:
            content = self._bucket.get(f"{name}/{SIGNATURES}/{version}", MAX_SIGNATURE_BYTES)
        except FileNotFoundError:
            return None
        except FAILURES:
            return self._cache.signature(name, version)
        self._cache.keep_signature(name, version, content)
        return content

    def sign(self, name: str, version: int, signature: bytes) -> None:
        """See ``Storage.sign``; the state is touched, so that fingerprints tell."""
        try:
            self._bucket.put(f"{name}/{SIGNATURES}/{version}", signature)
            self._commit(name, lambda _: Event(SIGN, None, version))
        except FAILURES as error:
            raise RegistryError(f"{name}@{version}: {reason(error)}; it was not signed") from error

    def fingerprint(self) -> Hashable:
        """See ``Storage.fingerprint``: one listing, and one look at the state of each model."""
        try:
            names = sorted(filter(is_name, self._bucket.folders()))
            return tuple((name, self._bucket.tag(f"{name}/{STATE_FILE}")) for name in names)
        except FAILURES as error:
            raise RegistryError(f"the store cannot be reached: {reason(error)}") from error

    def survey(self) -> Sequence[Finding]:
        """See ``Storage.survey``: contents that no state names."""
        advice = "left by a writer that was interrupted, or being written now; it costs room and nothing else"
        found = []
        try:
            for name in self.models():
                state = self.state(name)
                for folder in self._bucket.folders(f"{name}/"):
                    version = parse_version(folder)
                    if version is not None and version not in state.versions | state.removed:
                        found.append(Finding(f"{name}/{version}", "is not finished", advice, severe=False))
        except FAILURES as error:
            raise RegistryError(f"the store cannot be reached: {reason(error)}") from error
        return found

    def _claim(
        self, name: str, files: Mapping[str, bytes], manifest: Callable[[int], bytes], number: int | None
    ) -> tuple[int, bytes]:
        """Contents under a number that nobody has, the manifest last."""
        version = self._state_file(name)[0].state.free(number)
        while True:
            content = manifest(version)
            try:
                for file in (MODEL_FILE, CARD_FILE):
                    self._bucket.create(f"{name}/{version}/{file}", files[file])
                self._bucket.create(f"{name}/{version}/{MANIFEST_FILE}", content)
            except AlreadyExistsError as error:
                if number is not None:
                    raise ConflictError(f"version {number} is taken, or being published") from error
                version += 1
            else:
                return version, content

    def _commit(self, name: str, decide: Decision) -> Event:
        """Replace the state on condition that it is the one that was decided on; again, if it was not."""
        for _ in range(ATTEMPTS):
            found, tag = self._state_file(name)
            self._record(name, found)
            event = decide(found.state).signed_off(user(), FileDigest.of(found.event).sha256)
            line = event.render()
            after = _StateFile(found.state.after(event), found.generation + 1, line)
            if self._bucket.replace(f"{name}/{STATE_FILE}", after.render(), tag):
                self._record(name, after)
                return event
        raise RegistryError(f"{name}: others changed it {ATTEMPTS} times in a row; try again")

    def _record(self, name: str, found: _StateFile) -> None:
        """The last event has its object in the history, whoever writes it."""
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
        """What is left of a removed version is its number and its manifest."""
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
    except RuntimeError as error:  # a user whom the system does not know, as in containers
        raise RegistryError(
            "copies of a bucket's models have no place: this user has no home; set CAZSL_CACHE to a folder of its own"
        ) from error
