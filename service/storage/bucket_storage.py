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

import contextlib
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Self

from service.errors import BrokenModelError, ConflictError, PublishError, RegistryError
from service.model.manifest import CARD_FILE, MANIFEST_FILE, MODEL_FILE, FileDigest
from service.model.reference import is_name
from service.storage.base import ATTEMPTS, MAX_HISTORY_BYTES, MAX_SIGNATURE_BYTES, Decision, RegistryFinding, settled
from service.storage.bucket import FAILURES, AlreadyExistsError, Bucket, StoreFailure, reason
from service.storage.bucket_cache import Cache, cache_folder
from service.storage.bucket_state import MAX_STATE_BYTES, STATE_FILE, StateFile
from service.storage.folder_writer import SIGNATURES
from service.storage.history import MAX_LINE_BYTES, PUBLISH, REMOVE, SIGN, Event, History, ModelState, current_user
from service.storage.survey import EVENTS, bucket_strangers, event_file, event_number, misplaced_objects


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
        return cls(bucket, Cache((cache or cache_folder()) / FileDigest.of(bucket.address.encode()).sha256[:32]))

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

    def strangers(self) -> Sequence[RegistryFinding]:
        """See ``Storage.strangers``. If the store cannot be reached there are none, and ``models`` tells why."""
        try:
            return list(bucket_strangers(self._bucket.entries))
        except FAILURES:
            return []

    def state(self, name: str) -> ModelState:
        """See ``Storage.state``. If the store cannot be reached, the cached state is returned."""
        try:
            found, _, content = self._state_file(name)
        except FAILURES as error:
            if (known := self._cache.state(name)) is None:
                raise RegistryError(f"{name}: the state cannot be read: {reason(error)}") from error
            return StateFile.parse(known).state
        if content is not None:
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
        """See ``Storage.history``. The state tells how many events there are, so a missing one is noticed."""
        try:
            found, files = settled(lambda: self._state_file(name)[0], lambda: self._bucket.files(f"{name}/{EVENTS}/"))
            numbers = sorted(filter(None, map(event_number, files)))
            lines = [
                self._bucket.get(_event_key(name, number), MAX_LINE_BYTES)
                for number in numbers
                if number < found.generation
            ]
        except FAILURES as error:
            raise RegistryError(f"{name}: the history cannot be read: {reason(error)}") from error
        if sum(map(len, lines)) > MAX_HISTORY_BYTES:
            raise RegistryError(f"{name}: the history is larger than {MAX_HISTORY_BYTES} bytes")
        history = History.parse(b"".join([*lines, found.event]))
        missing, surplus = max(found.generation - 1, 0) - len(lines), sum(map(found.generation.__lt__, numbers))
        problems = list(history.problems)
        if missing:
            problems.append(f"{missing} of {found.generation} events are missing")
        if surplus:
            problems.append(f"{surplus} events are later than {STATE_FILE}, which was put back or cut off")
        return replace(history, problems=tuple(problems))

    def signature(self, name: str, version: int) -> bytes | None:
        """See ``Storage.signature``. If the store cannot be reached, the cached signature is returned."""
        try:
            content = self._bucket.get(f"{name}/{SIGNATURES}/{version}", MAX_SIGNATURE_BYTES)
        except FileNotFoundError:
            return None
        except StoreFailure as error:
            if error.is_outage:
                return self._cache.signature(name, version)
            raise BrokenModelError(f"signature: {reason(error)}") from error
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
            folders, _ = self._bucket.entries()
            return (*sorted(folders), *(self._tag(name) for name in sorted(filter(is_name, folders))))
        except FAILURES as error:
            raise RegistryError(f"the registry cannot be listed: {reason(error)}") from error

    def _tag(self, name: str) -> str | None:
        """Return the tag of a state, or why there is none. Only an outage of the whole store is raised."""
        try:
            return self._bucket.tag(f"{name}/{STATE_FILE}")
        except StoreFailure as error:
            if error.is_outage:
                raise
            return str(error)

    def survey(self) -> Sequence[RegistryFinding]:
        """See ``Storage.survey``."""
        try:
            found = list(bucket_strangers(self._bucket.entries))
        except FAILURES as error:
            raise RegistryError(f"the registry cannot be listed: {reason(error)}") from error
        for name in self.models():
            with contextlib.suppress(RegistryError, *FAILURES):
                found += misplaced_objects(self._bucket.entries, name, self.state(name))
        return found

    def _claim(
        self, name: str, files: Mapping[str, bytes], manifest: Callable[[int], bytes], number: int | None
    ) -> tuple[int, bytes]:
        """Create the files of a version under an unused number, the manifest last. Return number and manifest.

        If the number is given, files that an interrupted writer of the same bytes left are completed.
        """
        version = self._state_file(name)[0].state.free_number(number)
        while True:
            content = manifest(version)
            try:
                for file, part in (
                    (MODEL_FILE, files[MODEL_FILE]),
                    (CARD_FILE, files[CARD_FILE]),
                    (MANIFEST_FILE, content),
                ):
                    self._create(f"{name}/{version}/{file}", part, completes=number is not None)
            except AlreadyExistsError as error:
                if number is not None:
                    raise ConflictError(
                        f"{name}: version {number} is being published with other files, or was left incomplete; "
                        f"choose another number, or delete {name}/{number}/ in the bucket once no one writes"
                    ) from error
                version += 1
            else:
                return version, content

    def _create(self, key: str, content: bytes, completes: bool) -> None:
        """Create an object. If ``completes``, one that has these bytes already is as good."""
        try:
            self._bucket.create(key, content)
        except AlreadyExistsError:
            if not completes or not self._bucket.holds(key, content):
                raise

    def _commit(self, name: str, decide: Decision) -> Event:
        """Replace the state if it is still the one that ``decide`` saw. Otherwise decide again."""
        for _ in range(ATTEMPTS):
            found, tag, _ = self._state_file(name)
            self._record(name, found)
            event = decide(found.state).stamped(current_user(), FileDigest.of(found.event).sha256)
            line = event.render()
            after = StateFile(found.state.after(event), found.generation + 1, line)
            if self._bucket.replace(f"{name}/{STATE_FILE}", after.render(), tag):
                self._record(name, after)
                return event
        raise RegistryError(f"{name}: other writers changed it {ATTEMPTS} times in a row; try again")

    def _record(self, name: str, found: StateFile) -> None:
        """Write the last event into the history, unless another writer did."""
        if found.generation:
            try:
                self._bucket.create(_event_key(name, found.generation), found.event)
            except AlreadyExistsError:
                return

    def _state_file(self, name: str) -> tuple[StateFile, str | None, bytes | None]:
        """Read the state with its tag and its bytes. A model without a state has neither.

        Raises:
            BrokenModelError: it is not a state, or it is missing although the model has a history.
        """
        for _ in range(2):
            try:
                content, tag = self._bucket.get_tagged(f"{name}/{STATE_FILE}", MAX_STATE_BYTES)
            except FileNotFoundError:
                if not self._bucket.files(f"{name}/{EVENTS}/"):
                    return StateFile(), None, None
            else:
                return StateFile.parse(content), tag, content
        # A state is older than its history, so the second read would have found it.
        raise BrokenModelError(
            f"{name}: {STATE_FILE} is missing, although there is a history; restore it from a backup"
        )

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
    return f"{name}/{EVENTS}/{event_file(number)}"
