"""Tests of the registry in a folder: whole versions, verified reading, names, aliases and history."""

import json
import os
from dataclasses import replace
from multiprocessing.pool import ThreadPool
from pathlib import Path

import pytest

from service.errors import BrokenModelError, PublishError, RegistryError, UnknownModelError
from service.model.manifest import MAX_MANIFEST_BYTES
from service.model.reference import ModelReference
from service.registry.registry import Registry
from tests.fakes import draft_manifest, publish_fake

NAME = "push-indicator"


@pytest.fixture
def registry(tmp_path: Path) -> Registry:
    """A registry with one model of one version, which is its champion."""
    found = Registry(tmp_path / "models")
    publish_fake(found)
    return found


def folder(registry: Registry, version: int = 1) -> Path:
    """Return the folder of a version."""
    return registry.root / NAME / str(version)


def everything(root: Path) -> dict[str, tuple[bytes, int]]:
    """Return the bytes and the modification time of every file below a folder."""
    return {str(path): (path.read_bytes(), path.stat().st_mtime_ns) for path in root.rglob("*") if path.is_file()}


def test_published_version_is_read_back(registry: Registry) -> None:
    """A published version is read back with its manifest, model and card."""
    found = registry.read(NAME, 1)
    assert found.model == b"fine"
    assert found.card == f"# {NAME}\n"
    assert (found.manifest.name, found.manifest.version) == (NAME, 1)
    assert registry.names() == [NAME]
    assert registry.aliases(NAME) == {"champion": 1}


def test_versions_are_sorted_as_numbers(registry: Registry) -> None:
    """Version 10 is newer than version 9."""
    for _ in range(9):
        publish_fake(registry, alias=None)
    assert registry.versions(NAME) == list(range(1, 11))


def test_reference_is_resolved_by_name_alias_or_version(registry: Registry) -> None:
    """A name alone means its champion, which stays the same when a version is added."""
    publish_fake(registry, alias=None)
    assert registry.resolve(ModelReference.parse(NAME)) == 1
    assert registry.resolve(ModelReference.parse(f"{NAME}@2")) == 2
    registry.point_alias(NAME, "canary", 2)
    assert registry.resolve(ModelReference.parse(f"{NAME}@canary")) == 2


@pytest.mark.parametrize("text", ["push-none", f"{NAME}@3", f"{NAME}@canary"], ids=["model", "version", "alias"])
def test_reference_without_a_version_is_unknown(registry: Registry, text: str) -> None:
    """A reference to a missing model, version or alias raises UnknownModelError."""
    with pytest.raises(UnknownModelError, match="there is no"):
        registry.resolve(ModelReference.parse(text))


def test_reading_changes_no_file(registry: Registry) -> None:
    """Reading leaves every byte and modification time unchanged, and needs no write permission."""
    before = everything(registry.root)
    for path in (registry.root, *registry.root.rglob("*")):
        path.chmod(0o555 if path.is_dir() else 0o444)
    registry.read(NAME, registry.resolve(ModelReference.parse(NAME)))
    registry.fingerprint()
    for path in (registry.root, *registry.root.rglob("*")):
        path.chmod(0o755 if path.is_dir() else 0o644)
    assert everything(registry.root) == before


@pytest.mark.parametrize("file", ["model.onnx", "card.md"])
def test_flipped_bit_of_a_file_is_refused_by_its_name(registry: Registry, file: str) -> None:
    """Any flipped bit of a file with a digest makes reading fail with the name of the file."""
    path = folder(registry) / file
    content = path.read_bytes()
    for place in range(len(content)):
        for bit in range(8):
            path.write_bytes(content[:place] + bytes([content[place] ^ 1 << bit]) + content[place + 1 :])
            with pytest.raises(BrokenModelError, match=file.replace(".", r"\.")):
                registry.read(NAME, 1)
    path.write_bytes(content)
    assert registry.read(NAME, 1).model == b"fine"


def test_flipped_bit_of_a_digest_is_refused(registry: Registry) -> None:
    """Any flipped bit of a digest in the manifest makes reading fail."""
    path = folder(registry) / "manifest.json"
    content = path.read_bytes()
    start = content.index(b'"sha256"', content.index(b'"files"')) + len(b'"sha256": "')
    for place in range(start, start + 64):
        for bit in range(8):
            path.write_bytes(content[:place] + bytes([content[place] ^ 1 << bit]) + content[place + 1 :])
            with pytest.raises(BrokenModelError):
                registry.read(NAME, 1)


@pytest.mark.parametrize("file", ["model.onnx", "card.md", "manifest.json"])
@pytest.mark.parametrize("how", ["missing", "empty", "longer", "folder", "symlink", "pipe", "huge"])
def test_replaced_file_is_refused_by_its_name(registry: Registry, file: str, how: str, tmp_path: Path) -> None:
    """A file that is missing, truncated, extended or not regular is refused by its name, without hanging."""
    path = folder(registry) / file
    content = path.read_bytes()
    path.unlink()
    match how:
        case "empty":
            path.write_bytes(b"")
        case "longer":
            path.write_bytes(content + b"x")
        case "folder":
            path.mkdir()
        case "symlink":
            (tmp_path / "elsewhere").write_bytes(content)
            path.symlink_to(tmp_path / "elsewhere")
        case "pipe":
            os.mkfifo(path)
        case "huge":
            with path.open("wb") as sparse:
                sparse.truncate(1 << 40)
    with pytest.raises(BrokenModelError, match=file.replace(".", r"\.")):
        registry.read(NAME, 1)


def test_file_outside_the_manifest_is_refused(registry: Registry) -> None:
    """A version with a file that its manifest does not list is refused."""
    (folder(registry) / "extra.bin").write_bytes(b"")
    with pytest.raises(BrokenModelError, match="not in the manifest"):
        registry.read(NAME, 1)


def test_version_under_another_number_is_refused(registry: Registry) -> None:
    """A version folder that was renamed to another number is refused."""
    folder(registry).rename(folder(registry, 7))
    with pytest.raises(BrokenModelError, match="found as push-indicator@7"):
        registry.read(NAME, 7)


def test_linked_version_is_refused(registry: Registry, tmp_path: Path) -> None:
    """A link to a valid version outside the registry is not followed."""
    outside = tmp_path / "outside"
    folder(registry).rename(outside)
    folder(registry).symlink_to(outside)
    with pytest.raises(BrokenModelError, match="links are not followed"):
        registry.read(NAME, 1)


@pytest.mark.parametrize("name", ["..", ".", "a/b", "/etc", "", "UPPER", "x" * 65])
def test_invalid_name_is_refused_before_the_file_system(registry: Registry, name: str) -> None:
    """An invalid model name is refused before a path is made of it."""
    with pytest.raises(RegistryError, match="lower-case"):
        registry.read(name, 1)
    with pytest.raises(RegistryError, match="lower-case"):
        registry.versions(name)


def test_other_entries_are_not_listed(registry: Registry) -> None:
    """Stray files, hidden folders and numbers with leading zeros are listed neither as models nor as versions."""
    (registry.root / "README.md").write_text("hello")
    (registry.root / ".git").mkdir()
    (registry.root / NAME / "007").mkdir()
    (registry.root / NAME / ".staging-1").mkdir()
    assert registry.names() == [NAME]
    assert registry.versions(NAME) == [1]


@pytest.mark.parametrize("content", [b"", b"two\n", b"0\n", b"1\n2\n", b"../1\n", b"1" * 17, b"\xff\n"])
def test_alias_file_without_a_version_is_ignored(registry: Registry, content: bytes) -> None:
    """An alias file that does not hold exactly one version number is ignored."""
    (registry.root / NAME / "aliases" / "champion").write_bytes(content)
    assert registry.aliases(NAME) == {}


def test_alias_is_not_moved_to_a_broken_version(registry: Registry) -> None:
    """An alias cannot be pointed at a version that fails verification, and stays."""
    publish_fake(registry, alias=None)
    (folder(registry, 2) / "model.onnx").write_bytes(b"FINE")
    with pytest.raises(BrokenModelError, match=r"model\.onnx"):
        registry.point_alias(NAME, "champion", 2)
    assert registry.aliases(NAME) == {"champion": 1}


@pytest.mark.parametrize("alias", ["3", "../champion", "", "Champion"])
def test_invalid_alias_is_refused(registry: Registry, alias: str) -> None:
    """An alias that is a number, a path, empty or in capitals is refused."""
    with pytest.raises(RegistryError, match="alias: accepted are"):
        registry.point_alias(NAME, alias, 1)


def test_existing_version_is_never_replaced(registry: Registry) -> None:
    """A second publish takes the next number, and the first version keeps every byte."""
    before = everything(folder(registry))
    assert publish_fake(registry, alias=None) == 2
    assert everything(folder(registry)) == before


def test_concurrent_publishers_get_consecutive_numbers(tmp_path: Path) -> None:
    """Four concurrent publishers make twelve whole versions with the numbers 1 to 12, and leave no staging folder."""
    registry = Registry(tmp_path / "models")
    with ThreadPool(4) as pool:
        versions = pool.map(lambda _: publish_fake(registry, alias=None), range(12))
    assert sorted(versions) == registry.versions(NAME) == list(range(1, 13))
    for version in versions:
        registry.read(NAME, version)
    assert not list((registry.root / NAME).glob(".staging-*"))


def test_history_has_a_line_for_every_publish_and_move(registry: Registry) -> None:
    """The history has a line with time, user, event, old and new version for every publish and alias move."""
    publish_fake(registry)
    lines = [json.loads(line) for line in (registry.root / NAME / "history.jsonl").read_text().splitlines()]
    found = [(line["what"], line["from"], line["to"]) for line in lines]
    assert found == [("publish", None, 1), ("alias champion", None, 1), ("publish", None, 2), ("alias champion", 1, 2)]
    assert all(line["time"] and line["who"] for line in lines)


def test_invalid_draft_is_not_published(registry: Registry) -> None:
    """A draft with invalid outputs is refused before a version becomes visible."""
    with pytest.raises(BrokenModelError, match="outputs"):
        registry.publish(replace(draft_manifest(), outputs=()), b"fine", "card")
    assert registry.versions(NAME) == [1]


def test_refusing_disk_is_a_publish_error(tmp_path: Path) -> None:
    """A registry whose folder cannot be created raises PublishError."""
    (tmp_path / "models").write_text("a file in the way")
    with pytest.raises(PublishError, match="no version was published"):
        publish_fake(Registry(tmp_path / "models"))


def test_missing_registry_is_an_error(tmp_path: Path) -> None:
    """A missing registry is an error, not an empty registry."""
    with pytest.raises(RegistryError, match="cannot be listed"):
        Registry(tmp_path / "gone").names()


def test_sizes_are_bounded_before_reading(registry: Registry) -> None:
    """A manifest over its size limit is refused before it is read."""
    with (folder(registry) / "manifest.json").open("ab") as file:
        file.write(b" " * MAX_MANIFEST_BYTES)
    with pytest.raises(BrokenModelError, match=f"more than {MAX_MANIFEST_BYTES} bytes"):
        registry.read(NAME, 1)
