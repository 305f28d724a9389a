"""Registry of models: list, resolve, read verified bytes, publish, move aliases, remove, and read the history.

Versions are positive integers, never changed and never used twice. An alias names a version that passes verification.
Moving an alias is compare-and-set. Everything that a storage returns is checked: names before a path is made of them,
sizes before reading, and digests before any byte is returned. The returned bytes are the compared ones. A storage
(``service.storage.base``) decides where the bytes lie and how a change becomes visible.
"""

from collections.abc import Hashable, Sequence
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import Final

from service.errors import ConflictError, InUseError, RegistryError, UnknownModelError
from service.model.domain import Domain
from service.model.manifest import MANIFEST_FILE, Manifest
from service.model.reference import ModelReference, is_alias, is_name
from service.model.strict_json import check_text
from service.pushing.gates import PUSHING
from service.registry.draft import Draft
from service.registry.verification import MAX_MODEL_BYTES, Requirements, Signatures, VerifiedVersion, verify
from service.storage.base import MAX_SIGNATURE_BYTES, RegistryFinding, Storage, settled
from service.storage.folder_storage import FolderStorage
from service.storage.history import REMOVE, Event, History, ModelState, unrecorded

NOWHERE: Final = 0  # as an expected version: the alias does not exist yet
MAX_REASON: Final = 2_000  # characters, with the gates that a promotion was forced past


class Registry:
    """A registry of models in a folder, or in any other storage."""

    def __init__(
        self,
        location: Path | Storage,
        signatures: Signatures | None = None,
        max_model_bytes: int = MAX_MODEL_BYTES,
        domain: Domain = PUSHING,
    ) -> None:
        self.storage: Storage = FolderStorage(location) if isinstance(location, Path) else location
        self.domain = domain
        self._required = Requirements(domain, signatures, max_model_bytes)

    @property
    def root(self) -> Path:
        """The folder of a registry that lies in a folder.

        Raises:
            RegistryError: the registry lies in another storage.
        """
        if not isinstance(self.storage, FolderStorage):
            raise RegistryError("registry: it lies in a bucket, and this operation needs a folder")
        return self.storage.root

    def names(self) -> list[str]:
        """Return the names of all models, sorted.

        Raises:
            RegistryError: the storage cannot be listed.
        """
        return self.storage.models()

    def strangers(self) -> Sequence[RegistryFinding]:
        """Return a finding for each entry beside the models that is none. It is severe if it is in a model's place.

        Raises:
            RegistryError: the storage cannot be listed.
        """
        return self.storage.strangers()

    def state(self, name: str) -> ModelState:
        """Return versions, aliases and removed numbers of a model.

        Raises:
            RegistryError: the state cannot be read.
        """
        return self.storage.state(_checked(name))

    def versions(self, name: str) -> list[int]:
        """Return the visible versions of a model, oldest first. Version 10 is newer than version 9.

        Raises:
            RegistryError: the state cannot be read.
        """
        return sorted(self.state(name).versions)

    def aliases(self, name: str) -> dict[str, int]:
        """Return the version that each alias of a model names, sorted by alias.

        Raises:
            RegistryError: the state cannot be read.
        """
        return dict(sorted(self.state(name).aliases.items()))

    def resolve(self, reference: ModelReference) -> int:
        """Return the version that a reference names now.

        Raises:
            UnknownModelError: there is no such model, version or alias.
        """
        state = self.state(self._known(reference.name))
        version = reference.version
        if reference.alias is not None:
            version = state.aliases.get(reference.alias)
        if version is None or version not in state.versions:
            raise UnknownModelError(
                f"there is no {reference}; versions of {reference.name}: {_listed(sorted(state.versions))}"
            )
        return version

    def read(self, name: str, version: int) -> VerifiedVersion:
        """Read a version and verify its format, list of files, sizes, digests and signature.

        Raises:
            BrokenModelError: verification failed. The message names the file, the value found and the one expected.
        """
        return verify(self.storage, _checked(name), version, self._required)

    def publish(self, draft: Manifest, model: bytes, card: str) -> Manifest:
        """Publish a draft as the next version, with its number and digests filled in. Return the published manifest.

        Raises:
            PublishError, BrokenModelError: the storage refused, or the draft is invalid. No version became visible.
            RegistryError: the version is visible, but could not be recorded.
        """
        made = Draft.of(draft, model, card, self._required)
        return replace(made.whole, version=self.storage.publish(_checked(draft.name), made.files, made.manifest))

    def copy(self, source: "Registry", name: str, version: int) -> VerifiedVersion:
        """Copy a version with its number and signature from another registry. It is verified at both ends.

        Raises:
            BrokenModelError: the version does not pass verification in the source, or here afterwards.
            ConflictError: this registry has, or had, another version of that number.
            PublishError: this storage refused. No version became visible.
        """
        there = source.read(name, version)
        parts = {file: content for file, content in there.files.items() if file != MANIFEST_FILE}
        try:
            self.storage.publish(name, parts, lambda _: there.files[MANIFEST_FILE], version)
        except ConflictError:
            if version not in self.state(name).versions:
                raise
        here = verify(self.storage, name, version, replace(self._required, signatures=None))
        if here.files != there.files:
            raise ConflictError(f"{name}@{version} is another version in the destination; no change was made")
        complete = there.signature == here.signature and self.storage.history(name).has_signing(version)
        if there.signature is not None and not complete:  # an interrupted copy may not have recorded it
            self.storage.sign(name, version, there.signature)
        return self.read(name, version)

    def point_alias(
        self, name: str, alias: str, version: int, *, expect: int | None = None, reason: str | None = None
    ) -> Event:
        """Point an alias at a version that passes verification, by compare-and-set.

        ``expect`` is the version that the alias must name at the instant of the move. ``NOWHERE``: the alias must not
        exist yet. None: any version.

        Raises:
            RegistryError: the alias is not a valid name, or the storage refused.
            ConflictError: the alias does not name the expected version. It stays.
            BrokenModelError: the version does not pass verification. The alias stays.
        """
        _check_alias(alias)
        _check_reason(reason)
        self.read(name, version)

        def decide(state: ModelState) -> Event:
            """Move the alias if it names the expected version."""
            found = state.aliases.get(alias)
            if expect is not None and found != (expect or None):
                names, expected = found or "no version", expect or "no version"
                raise ConflictError(f"{name}@{alias} names {names}, but {expected} was expected; the alias stays")
            if version not in state.versions:
                raise ConflictError(f"{name}@{version} was removed in the meantime; {name}@{alias} stays")
            return Event.alias_move(alias, found, version, reason)

        return self.storage.commit(name, decide)

    def drop_alias(self, name: str, alias: str, *, reason: str | None = None) -> Event:
        """Drop an alias. The version that it named stays.

        Raises:
            UnknownModelError: there is no such alias.
            RegistryError: the storage refused.
        """
        _check_alias(alias)
        _check_reason(reason)

        def decide(state: ModelState) -> Event:
            """Drop the alias if it exists. One that disappeared, or cannot be read, is dropped too."""
            known = alias in state.aliases or state.is_unknown(alias)
            if not known and alias not in self.storage.history(name).lost(state).aliases:
                raise UnknownModelError(f"there is no {name}@{alias}; aliases: {_listed(sorted(state.aliases))}")
            return Event.alias_move(alias, state.aliases.get(alias), None, reason)

        return self.storage.commit(self._known(name), decide)

    def remove(self, name: str, version: int, *, reason: str | None = None) -> Event:
        """Remove a version for good. Its number is never used again.

        Raises:
            UnknownModelError: there is no such version.
            InUseError: an alias names it.
            RegistryError: the storage refused.
        """
        _check_reason(reason)

        def decide(state: ModelState) -> Event:
            """Remove the version if no alias names it. One that disappeared is removed too."""
            if version not in state.versions and version not in self.storage.history(name).lost(state).versions:
                raise UnknownModelError(f"there is no {name}@{version}; versions: {_listed(sorted(state.versions))}")
            if naming := state.naming(version):
                raise InUseError(f"{name}@{version} is named by {', '.join(naming)}; move or remove the alias first")
            return Event(REMOVE, version, None, reason=reason)

        return self.storage.commit(self._known(name), decide)

    def history(self, name: str) -> History:
        """Return the history of a model. Changes without a line are those of ``unrecorded``.

        Raises:
            RegistryError: the history cannot be read.
        """
        return self.storage.history(self._known(name))

    def unrecorded(self, name: str) -> Sequence[Event]:
        """Return the changes that the history lacks. The next change records them.

        Raises:
            RegistryError: the history or the state cannot be read.
        """
        state, history = self.record(name)
        return unrecorded(history.state(), state)

    def record(self, name: str) -> tuple[ModelState, History]:
        """Return the state and the history of a model at one instant. Errors are those of ``history`` and ``state``."""
        history, state = settled(lambda: self.history(name), lambda: self.state(name))
        return state, history

    def alias_at(self, name: str, alias: str, when: datetime) -> int | None:
        """Return the version that an alias named at an instant, from the history. None: it named none."""
        return self.history(name).state(when).aliases.get(alias)

    def sign(self, name: str, version: int, signature: bytes) -> None:
        """Store the detached signature of a version.

        Raises:
            RegistryError: the signature could not be stored.
        """
        if len(signature) > MAX_SIGNATURE_BYTES:
            raise RegistryError(f"signature: {len(signature)} bytes; at most {MAX_SIGNATURE_BYTES} are accepted")
        self.storage.sign(self._known(name), version, signature)

    def fingerprint(self) -> Hashable:
        """Return a value that changes with every version, alias and signature.

        Raises:
            RegistryError: the storage cannot be listed.
        """
        return self.storage.fingerprint()

    def survey(self) -> Sequence[RegistryFinding]:
        """Return a finding for each entry of the storage that is not part of its layout.

        Raises:
            RegistryError: the storage cannot be listed.
        """
        return self.storage.survey()

    def _known(self, name: str) -> str:
        names = self.names()
        if _checked(name) in names:
            return name
        raise UnknownModelError(f"there is no model {name}; models: {_listed(names)}")


def _checked(name: str) -> str:
    if not is_name(name):
        raise RegistryError("name of a model: accepted are 1 to 64 lower-case letters, digits, '-' and '_'")
    return name


def _check_alias(alias: str) -> None:
    if not is_alias(alias):
        raise RegistryError("alias: accepted are 1 to 64 lower-case letters, digits, '-' and '_', but not a number")


def _check_reason(reason: str | None) -> None:
    """Accept a reason that the history can keep: one line of text."""
    try:
        check_text(reason or "", MAX_REASON)
    except ValueError as error:
        raise RegistryError(f"reason: {error}") from error


def _listed(entries: Sequence[object]) -> str:
    return ", ".join(map(str, entries[-10:])) or "none"
