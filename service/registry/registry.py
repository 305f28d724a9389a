"""The registry of models: list, resolve, read verified bytes, publish, move aliases, remove, tell what happened.

Versions are positive integers, never changed and never given twice. An alias names a version that passes verification;
moving one is compare-and-set. Nothing that a storage hands over is believed: names are checked before it is asked,
sizes are bounded before reading, and digests are compared before anyone gets a byte, which is then the very byte that
was compared. Where the bytes lie, and how a change becomes visible, is ``service.storage.base``'s business.
"""

from collections.abc import Hashable, Sequence
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import Final

from service.errors import BrokenModelError, ConflictError, InUseError, RegistryError, UnknownModelError
from service.model.manifest import CARD_FILE, FORMAT, MANIFEST_FILE, MODEL_FILE, FileDigest, Manifest
from service.model.reference import ModelReference, is_alias, is_name
from service.registry.verification import (
    MAX_CARD_BYTES,
    MAX_MANIFEST_BYTES,
    MAX_MODEL_BYTES,
    Signatures,
    VerifiedVersion,
    verify,
)
from service.storage.base import Finding, Storage
from service.storage.folder_storage import FolderStorage
from service.storage.history import REMOVE, Event, History, ModelState, unrecorded

NOWHERE: Final = 0  # as an expectation: the alias is not there yet


class Registry:
    """A registry of models in a folder, or in any other storage."""

    def __init__(
        self,
        location: Path | Storage,
        signatures: Signatures | None = None,
        max_model_bytes: int = MAX_MODEL_BYTES,
    ) -> None:
        self.storage: Storage = FolderStorage(location) if isinstance(location, Path) else location
        self._signatures = signatures
        self._max_model_bytes = max_model_bytes

    @property
    def root(self) -> Path:
        """The folder, where the registry lies in one.

        Raises:
            RegistryError: it lies elsewhere.
        """
        if not isinstance(self.storage, FolderStorage):
            raise RegistryError("this registry is not a folder")
        return self.storage.root

    def names(self) -> list[str]:
        """The models, sorted.

        Raises:
            RegistryError: it cannot be told.
        """
        return self.storage.models()

    def state(self, name: str) -> ModelState:
        """Versions, aliases and spent numbers of a model.

        Raises:
            RegistryError: it cannot be told.
        """
        return self.storage.state(_checked(name))

    def versions(self, name: str) -> list[int]:
        """The visible versions of a model, oldest first; as numbers, so that 10 is newer than 9.

        Raises:
            RegistryError: it cannot be told.
        """
        return sorted(self.state(name).versions)

    def aliases(self, name: str) -> dict[str, int]:
        """Where each alias of a model points, sorted by alias; what is no alias is left out.

        Raises:
            RegistryError: it cannot be told.
        """
        return dict(sorted(self.state(name).aliases.items()))

    def resolve(self, reference: ModelReference) -> int:
        """The version that a reference means now.

        Raises:
            UnknownModelError: there is no such model, version or alias.
        """
        state = self.state(self._known(reference.name))
        version = reference.version
        if reference.alias is not None:
            version = state.aliases.get(reference.alias)
        if version is None or version not in state.versions:
            raise UnknownModelError(
                f"there is no {reference}; versions of {reference.name}: {_numbers(sorted(state.versions))}"
            )
        return version

    def read(self, name: str, version: int) -> VerifiedVersion:
        """Every byte of a version, verified: format, sizes, digests, no file too many or too few, signature.

        Raises:
            BrokenModelError: names the file that is at fault, what was found and what was expected.
        """
        return verify(self.storage, _checked(name), version, self._max_model_bytes, self._signatures)

    def publish(self, draft: Manifest, model: bytes, card: str) -> Manifest:
        """Make the next version visible, whole, and return its manifest; the draft's version and files are replaced.

        Raises:
            PublishError, BrokenModelError: the storage refused, or the draft breaks the contract; nothing is visible.
            RegistryError: the version is visible, and could not be recorded.
        """
        contents = {MODEL_FILE: model, CARD_FILE: card.encode()}
        for file, limit in ((MODEL_FILE, self._max_model_bytes), (CARD_FILE, MAX_CARD_BYTES)):
            if len(contents[file]) > limit:
                raise BrokenModelError(f"{file}: {len(contents[file])} bytes; at most {limit} can be read back")
        whole = replace(
            draft, format=FORMAT, files={file: FileDigest.of(content) for file, content in contents.items()}
        )

        def manifest(version: int) -> bytes:
            """The manifest of that number; what could not be read back must not become visible."""
            content = replace(whole, version=version).render()
            if len(content) > MAX_MANIFEST_BYTES:
                raise BrokenModelError(f"{MANIFEST_FILE}: {len(content)} bytes; at most {MAX_MANIFEST_BYTES}")
            Manifest.parse(content)
            return content

        return replace(whole, version=self.storage.publish(_checked(draft.name), contents, manifest))

    def copy(self, source: "Registry", name: str, version: int) -> VerifiedVersion:
        """Copy a version as it is, number and signature included, from another registry; verified at both ends.

        Raises:
            BrokenModelError: it does not pass verification there, or here afterwards.
            ConflictError: this registry has, or had, another version of that number.
            PublishError: this storage refused; nothing became visible.
        """
        there = source.read(name, version)
        parts = {file: content for file, content in there.files.items() if file != MANIFEST_FILE}
        try:
            self.storage.publish(name, parts, lambda _: there.files[MANIFEST_FILE], version)
        except ConflictError:
            if version not in self.state(name).versions:
                raise
        here = verify(self.storage, name, version, self._max_model_bytes, None)
        if here.files != there.files:
            raise ConflictError(f"{name}@{version} is another version here; nothing was changed")
        if there.signature not in (None, here.signature):
            self.storage.sign(name, version, there.signature)
        return self.read(name, version)

    def point_alias(
        self, name: str, alias: str, version: int, *, expect: int | None = None, reason: str | None = None
    ) -> Event:
        """Point an alias at a version that passes verification: compare-and-set.

        ``expect`` is the version that the alias must name at the instant of the move, ``NOWHERE`` where it must not be
        there yet, None where it does not matter.

        Raises:
            RegistryError: the alias is not a name, or the storage refused.
            ConflictError: the alias does not name what was expected; it stays.
            BrokenModelError: the version does not pass verification; the alias stays.
        """
        _check_alias(alias)
        self.read(name, version)

        def decide(state: ModelState) -> Event:
            """The move, on the state as it is."""
            found = state.aliases.get(alias)
            if expect is not None and found != (expect or None):
                raise ConflictError(f"{name}@{alias} names {found or 'nothing'}, not {expect or 'nothing'}; it stays")
            if version not in state.versions:
                raise ConflictError(f"{name}@{version} has been removed; {name}@{alias} stays")
            return Event.alias_move(alias, found, version, reason)

        return self.storage.commit(name, decide)

    def drop_alias(self, name: str, alias: str, *, reason: str | None = None) -> Event:
        """Take an alias away; the version that it named stays.

        Raises:
            UnknownModelError: there is no such alias.
            RegistryError: the storage refused.
        """
        _check_alias(alias)

        def decide(state: ModelState) -> Event:
            """The end of the alias, if it is there."""
            if alias not in state.aliases:
                raise UnknownModelError(f"there is no {name}@{alias}")
            return Event.alias_move(alias, state.aliases[alias], None, reason)

        return self.storage.commit(self._known(name), decide)

    def remove(self, name: str, version: int, *, reason: str | None = None) -> Event:
        """Remove a version for ever; its number is never given again.

        Raises:
            UnknownModelError: it is not there.
            InUseError: an alias names it.
            RegistryError: the storage refused.
        """

        def decide(state: ModelState) -> Event:
            """The removal, if nothing names the version at this instant."""
            if version not in state.versions:
                raise UnknownModelError(f"there is no {name}@{version}; versions: {_numbers(sorted(state.versions))}")
            naming = sorted(alias for alias, to in state.aliases.items() if to == version)
            if naming:
                raise InUseError(f"{name}@{version} is named by {', '.join(naming)}; point it elsewhere first")
            return Event(REMOVE, version, None, reason=reason)

        return self.storage.commit(self._known(name), decide)

    def history(self, name: str) -> History:
        """What happened to a model; ``unrecorded`` tells what no line tells of.

        Raises:
            RegistryError: it cannot be read.
        """
        return self.storage.history(self._known(name))

    def unrecorded(self, name: str) -> Sequence[Event]:
        """Changes that are there and not in the history; the next change records them.

        Raises:
            RegistryError: it cannot be told.
        """
        return unrecorded(self.history(name).state(), self.state(name))

    def alias_at(self, name: str, alias: str, when: datetime) -> int | None:
        """The version that an alias named at an instant, as the history tells it.

        Raises:
            RegistryError: the history cannot be read.
        """
        return self.history(name).state(when).aliases.get(alias)

    def sign(self, name: str, version: int, signature: bytes) -> None:
        """Store the detached signature of a version.

        Raises:
            RegistryError: it could not be stored.
        """
        self.storage.sign(self._known(name), version, signature)

    def fingerprint(self) -> Hashable:
        """Changes whenever a version, an alias or a signature appears, moves or goes.

        Raises:
            RegistryError: it cannot be told.
        """
        return self.storage.fingerprint()

    def survey(self) -> Sequence[Finding]:
        """What lies in the storage that is no part of the layout.

        Raises:
            RegistryError: it cannot be told.
        """
        return self.storage.survey()

    def _known(self, name: str) -> str:
        if _checked(name) in self.names():
            return name
        raise UnknownModelError(f"there is no model {name}")


def _checked(name: str) -> str:
    if not is_name(name):
        raise RegistryError("a model name is of lower-case letters, digits, '-' and '_'")
    return name


def _check_alias(alias: str) -> None:
    if not is_alias(alias):
        raise RegistryError("an alias is of lower-case letters, digits, '-' and '_', and not a number")


def _numbers(versions: list[int]) -> str:
    return ", ".join(map(str, versions[-10:])) or "none"
