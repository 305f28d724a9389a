"""Survey of a registry, in a folder or in a bucket: entries that are not part of its layout. No file is changed."""

import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Final

from service.errors import RegistryError
from service.model.manifest import MANIFEST_FILE
from service.model.reference import is_alias, is_name, parse_version
from service.storage.base import RegistryFinding
from service.storage.bucket_cache import VERSION_FILES
from service.storage.bucket_state import STATE_FILE
from service.storage.disk import legible, reason
from service.storage.folder_writer import HEAD, HISTORY, REMOVED, SIGNATURES, STAGING_PREFIX
from service.storage.history import ALIASES, ModelState

_NOT_OURS: Final = "lost+found"  # the file system's own folder at the root of a disk
EVENTS: Final = "history"  # folder of a bucket
PROBE: Final = "probe-"  # objects that only test the store, deleted at once
_MOVE: Final = "move it elsewhere"
_DELETE: Final = "it only takes space; delete it once no one writes"
_FOLDER: Final = "a folder"
_FILE: Final = "a file"
Entries = Callable[..., list[str]]
Objects = Callable[[str], tuple[list[str], list[str]]]  # folders and objects below a prefix


def folder_models_and_strangers(root: Path) -> tuple[list[str], list[RegistryFinding]]:
    """Return the models of a root, sorted, and its other entries. An entry in a model's place is a severe finding.

    Raises:
        RegistryError: the root cannot be listed.
    """
    try:
        with os.scandir(root) as entries:
            kinds = sorted((entry.name, _kind(entry)) for entry in entries)
    except OSError as error:
        raise RegistryError(f"the registry cannot be listed: {reason(error)}") from error
    names = [name for name, kind in kinds if is_name(name) and kind == _FOLDER]
    others = [(name, kind) for name, kind in kinds if name not in names]
    return names, [_stranger(name, kind) for name, kind in others if not name.startswith(".") and name != _NOT_OURS]


def _stranger(entry: str, kind: str) -> RegistryFinding:
    if kind == _FOLDER:
        return _misnamed(entry)
    if kind == _FILE and not is_name(entry):
        return RegistryFinding(legible(entry), "is not a model's folder", _MOVE, severe=False)
    return RegistryFinding(legible(entry), f"is {kind}, not a model's folder", f"{_MOVE}, or replace it by a folder")


def misplaced_files(name: str, entries: Entries) -> Iterator[RegistryFinding]:
    """Yield the entries of a model that are not part of the layout.

    Args:
        name: the model.
        entries: lists a folder of the registry by its parts. A missing folder has no entries.

    Raises:
        RegistryError: a folder cannot be listed.
    """
    versions = set()
    for part in sorted(entries(name)):
        if part.startswith(STAGING_PREFIX):
            advice = "a writer was interrupted, or is still writing; the next change deletes it"
            yield _note(f"{name}/{part}", "is incomplete", advice)
        elif (version := parse_version(part)) is not None:
            versions.add(version)
        elif part not in (ALIASES, REMOVED, SIGNATURES, HISTORY, HEAD):
            yield _note(f"{name}/{part}", "is not part of the layout", _MOVE)
    for part in _listed(entries, name, ALIASES):
        if not is_alias(part):
            yield _note(f"{name}/{ALIASES}/{part}", "is not the name of an alias", _MOVE)
    for part in _listed(entries, name, SIGNATURES):
        if parse_version(part) not in versions:
            yield _note(f"{name}/{SIGNATURES}/{part}", "is the signature of no version", _MOVE)
    for part in _listed(entries, name, REMOVED):
        if parse_version(part) is None:
            yield _note(f"{name}/{REMOVED}/{part}", "is not the number of a version", _MOVE)
        elif set(_listed(entries, name, REMOVED, part)) - {MANIFEST_FILE}:
            yield _note(
                f"{name}/{REMOVED}/{part}", "has files left of a removed version", "the next change deletes them"
            )


def _listed(entries: Entries, *parts: str) -> list[str]:
    """Return the sorted names in a folder below a model. One that cannot be read has none: ``state`` tells why."""
    try:
        return sorted(entries(*parts))
    except RegistryError:
        return []


def bucket_strangers(objects: Objects) -> Iterator[RegistryFinding]:
    """Yield the entries beside the models of a bucket. A folder is in a model's place, so it is severe."""
    folders, files = objects("")
    for folder in sorted(folders):
        if not is_name(folder):
            yield _misnamed(folder)
    for file in sorted(files):
        if file.startswith(PROBE):
            yield _note(file, "is left of an interrupted check of the store", _DELETE)
        else:
            yield _note(file, "is not a model's folder", _MOVE)


def misplaced_objects(objects: Objects, name: str, state: ModelState) -> Iterator[RegistryFinding]:
    """Yield the objects of a model that are not part of the layout, and versions that no state names."""
    folders, files = objects(f"{name}/")
    for file in sorted(set(files) - {STATE_FILE}):
        yield _note(f"{name}/{file}", "is not part of the layout", _MOVE)
    for folder in sorted(set(folders) - {EVENTS, SIGNATURES}):
        version, files = parse_version(folder), objects(f"{name}/{folder}/")[1]
        if version is None:
            yield _note(f"{name}/{folder}", "is not part of the layout", _MOVE)
        elif version in state.versions:
            for file in sorted(set(files) - VERSION_FILES):
                yield _note(f"{name}/{folder}/{file}", "is not part of a version", _MOVE)
        elif version not in state.removed:
            advice = f"a writer was interrupted, or is still writing; repeat its command, or: {_DELETE}"
            yield _note(f"{name}/{folder}", "is incomplete", advice)
        elif set(files) - {MANIFEST_FILE}:
            yield _note(f"{name}/{folder}", "has files left of a removed version", _DELETE)
    for file in sorted(objects(f"{name}/{EVENTS}/")[1]):
        if event_number(file) is None:
            yield _note(f"{name}/{EVENTS}/{file}", "is not an event", _MOVE)
    for file in sorted(objects(f"{name}/{SIGNATURES}/")[1]):
        if parse_version(file) not in state.versions:
            yield _note(f"{name}/{SIGNATURES}/{file}", "is the signature of no version", _MOVE)


def event_file(number: int) -> str:
    """Return the name of the object of an event."""
    return f"{number:09d}.json"


def event_number(file: str) -> int | None:
    """Return the number of an event from the name of its object, or None."""
    digits = file.removesuffix(".json")
    number = int(digits) if digits.isascii() and digits.isdigit() and len(digits) == len(event_file(0)) - 5 else 0
    return number if number and file == event_file(number) else None


def _misnamed(folder: str) -> RegistryFinding:
    wrong = "is a folder, but its name is not one of a model, so its versions are not served"
    advice = f"{_MOVE}, or rename it: accepted are 1 to 64 lower-case letters, digits, '-' and '_'"
    return RegistryFinding(legible(folder), wrong, advice)


def _note(where: str, wrong: str, advice: str) -> RegistryFinding:
    return RegistryFinding(legible(where), wrong, advice, severe=False)


def _kind(entry: os.DirEntry[str]) -> str:
    """Return the kind of an entry in words, without following links."""
    try:
        if entry.is_symlink():
            return "a link, which is not followed"
        if entry.is_dir(follow_symlinks=False):
            return _FOLDER
        return _FILE if entry.is_file(follow_symlinks=False) else "a pipe, a socket or a device"
    except OSError as error:
        return f"unreadable ({reason(error)})"
