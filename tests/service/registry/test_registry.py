"""The folder of models: whole versions or none, and nothing believed that is found on disk."""

import json
import os
from dataclasses import replace
from multiprocessing.pool import ThreadPool
from pathlib import Path

import pytest

from service.errors import BrokenModelError, PublishError, RegistryError, UnknownModelError
from service.model.reference import ModelReference
from service.registry.registry import Registry
from service.registry.verification import MAX_MANIFEST_BYTES
from tests.fakes import draft_manifest, publish_fake

NAME = "push-indicator"


@pytest.fixture
def registry(tmp_path: Path) -> Registry:
    """A registry with one model of one version, its champion."""
    found = Registry(tmp_path / "models")
    publish_fake(found)
    return found


def folder(registry: Registry, version: int = 1) -> Path:
    """Where a version lies."""
    return registry.root / NAME / str(version)


def everything(root: Path) -> dict[str, tuple[bytes, int]]:
    """Every file below a folder with its bytes and time."""
    return {str(path): (path.read_bytes(), path.stat().st_mtime_ns) for path in root.rglob("*") if path.is_file()}


def test_a_published_version_can_be_read_back(registry: Registry) -> None:
    """What was published is what is read, manifest, model and card."""
    found = registry.read(NAME, 1)
    assert found.model == b"fine"
    assert found.card == f"# {NAME}\n"
    assert (found.manifest.name, found.manifest.version) == (NAME, 1)
    assert registry.names() == [NAME]
    assert registry.aliases(NAME) == {"champion": 1}


def test_versions_are_numbers_not_texts(registry: Registry) -> None:
    """Version 10 is newer than version 9."""
    for _ in range(9):
        publish_fake(registry, alias=None)
    assert registry.versions(NAME) == list(range(1, 11))


def test_a_reference_resolves_by_alias_by_version_and_by_name(registry: Registry) -> None:
    """A name alone means its champion, which stays where it is when a version is added."""
    publish_fake(registry, alias=None)
    assert registry.resolve(ModelReference.parse(NAME)) == 1
    assert registry.resolve(ModelReference.parse(f"{NAME}@2")) == 2
    registry.point_alias(NAME, "canary", 2)
    assert registry.resolve(ModelReference.parse(f"{NAME}@canary")) == 2


@pytest.mark.parametrize("text", ["push-none", f"{NAME}@3", f"{NAME}@canary"], ids=["model", "version", "alias"])
def test_a_reference_to_nothing_is_unknown(registry: Registry, text: str) -> None:
    """The error says what there is."""
    with pytest.raises(UnknownModelError, match="there is no"):
        registry.resolve(ModelReference.parse(text))


def test_reading_changes_nothing(registry: Registry) -> None:
    """Every way of reading leaves every byte and every time as it was, and needs no right to write."""
    before = everything(registry.root)
    for path in (registry.root, *registry.root.rglob("*")):
        path.chmod(0o555 if path.is_dir() else 0o444)
    registry.read(NAME, registry.resolve(ModelReference.parse(NAME)))
    registry.fingerprint()
    for path in (registry.root, *registry.root.rglob("*")):
        path.chmod(0o755 if path.is_dir() else 0o644)
    assert everything(registry.root) == before


@pytest.mark.parametrize("file", ["model.onnx", "card.md"])
def test_any_flipped_bit_is_refused_by_the_name_of_its_file(registry: Registry, file: str) -> None:
    """No bit of what a manifest vouches for can change unseen."""
    path = folder(registry) / file
    content = path.read_bytes()
    for place in range(len(content)):
        for bit in range(8):
            path.write_bytes(content[:place] + bytes([content[place] ^ 1 << bit]) + content[place + 1 :])
            with pytest.raises(BrokenModelError, match=file.replace(".", r"\.")):
                registry.read(NAME, 1)
    path.write_bytes(content)
    assert registry.read(NAME, 1).model == b"fine"


def test_any_flipped_bit_of_a_digest_is_refused(registry: Registry) -> None:
    """A manifest that vouches for other bytes vouches for nothing: sizes and digests are its hard part."""
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
def test_a_file_that_is_not_the_published_one_is_refused(
    registry: Registry, file: str, how: str, tmp_path: Path
) -> None:
    """Missing, cut, grown, or something other than a regular file: the error names it and nothing hangs."""
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


def test_a_file_too_many_is_refused(registry: Registry) -> None:
    """A version holds what its manifest lists and nothing else."""
    (folder(registry) / "extra.bin").write_bytes(b"")
    with pytest.raises(BrokenModelError, match="not in the manifest"):
        registry.read(NAME, 1)


def test_a_version_under_another_number_is_refused(registry: Registry) -> None:
    """A copied folder is not another version."""
    folder(registry).rename(folder(registry, 7))
    with pytest.raises(BrokenModelError, match="found as push-indicator@7"):
        registry.read(NAME, 7)


def test_a_linked_version_is_refused(registry: Registry, tmp_path: Path) -> None:
    """A link to a whole version outside of the registry is not followed."""
    outside = tmp_path / "outside"
    folder(registry).rename(outside)
    folder(registry).symlink_to(outside)
    with pytest.raises(BrokenModelError, match="links are not followed"):
        registry.read(NAME, 1)


@pytest.mark.parametrize("name", ["..", ".", "a/b", "/etc", "", "UPPER", "x" * 65])
def test_a_name_that_is_no_name_reaches_no_path(registry: Registry, name: str) -> None:
    """Whatever asks, the file system is not asked."""
    with pytest.raises(RegistryError, match="lower-case"):
        registry.read(name, 1)
    with pytest.raises(RegistryError, match="lower-case"):
        registry.versions(name)


def test_entries_that_are_no_models_are_not_listed(registry: Registry) -> None:
    """Stray files, hidden folders and numbers with zeros are none of the registry's business."""
    (registry.root / "README.md").write_text("hello")
    (registry.root / ".git").mkdir()
    (registry.root / NAME / "007").mkdir()
    (registry.root / NAME / ".staging-1").mkdir()
    assert registry.names() == [NAME]
    assert registry.versions(NAME) == [1]


@pytest.mark.parametrize("content", [b"", b"two\n", b"0\n", b"1\n2\n", b"../1\n", b"1" * 17, b"\xff\n"])
def test_an_alias_file_that_holds_no_version_is_no_alias(registry: Registry, content: bytes) -> None:
    """A torn or forged alias means nothing rather than something."""
    (registry.root / NAME / "aliases" / "champion").write_bytes(content)
    assert registry.aliases(NAME) == {}


def test_an_alias_cannot_be_pointed_at_what_does_not_verify(registry: Registry) -> None:
    """A broken version never becomes the champion; the alias stays."""
    publish_fake(registry, alias=None)
    (folder(registry, 2) / "model.onnx").write_bytes(b"FINE")
    with pytest.raises(BrokenModelError, match=r"model\.onnx"):
        registry.point_alias(NAME, "champion", 2)
    assert registry.aliases(NAME) == {"champion": 1}


@pytest.mark.parametrize("alias", ["3", "../champion", "", "Champion"])
def test_an_alias_must_be_a_name(registry: Registry, alias: str) -> None:
    """A number would be taken for a version, a path for a path."""
    with pytest.raises(RegistryError, match="an alias"):
        registry.point_alias(NAME, alias, 1)


def test_a_version_in_the_way_is_never_replaced(registry: Registry) -> None:
    """The next free number is taken, and what was there keeps every byte."""
    before = everything(folder(registry))
    assert publish_fake(registry, alias=None) == 2
    assert everything(folder(registry)) == before


def test_publishers_at_once_get_a_number_each(tmp_path: Path) -> None:
    """Twelve versions from four publishers: twelve whole versions, no number twice."""
    registry = Registry(tmp_path / "models")
    with ThreadPool(4) as pool:
        versions = pool.map(lambda _: publish_fake(registry, alias=None), range(12))
    assert sorted(versions) == registry.versions(NAME) == list(range(1, 13))
    for version in versions:
        registry.read(NAME, version)
    assert not list((registry.root / NAME).glob(".staging-*"))


def test_history_has_a_line_for_every_publish_and_move(registry: Registry) -> None:
    """Time, user, what, from and to."""
    publish_fake(registry)
    lines = [json.loads(line) for line in (registry.root / NAME / "history.jsonl").read_text().splitlines()]
    found = [(line["what"], line["from"], line["to"]) for line in lines]
    assert found == [("publish", None, 1), ("alias champion", None, 1), ("publish", None, 2), ("alias champion", 1, 2)]
    assert all(line["time"] and line["who"] for line in lines)


def test_what_could_not_be_read_back_is_not_published(registry: Registry) -> None:
    """A draft that breaks the contract is refused before anything is visible."""
    with pytest.raises(BrokenModelError, match="outputs"):
        registry.publish(replace(draft_manifest(), outputs=()), b"fine", "card")
    assert registry.versions(NAME) == [1]


def test_a_disk_that_refuses_publishes_nothing(tmp_path: Path) -> None:
    """A registry whose folder cannot be made says so and leaves nothing."""
    (tmp_path / "models").write_text("a file in the way")
    with pytest.raises(PublishError, match="nothing was published"):
        publish_fake(Registry(tmp_path / "models"))


def test_a_missing_registry_is_an_error_not_an_empty_one(tmp_path: Path) -> None:
    """Gone and empty are different things."""
    with pytest.raises(RegistryError, match="cannot be listed"):
        Registry(tmp_path / "gone").names()


def test_sizes_are_bounded_before_reading(registry: Registry) -> None:
    """A manifest of a gigabyte costs no more than its limit."""
    with (folder(registry) / "manifest.json").open("ab") as file:
        file.write(b" " * MAX_MANIFEST_BYTES)
    with pytest.raises(BrokenModelError, match=f"more than {MAX_MANIFEST_BYTES} bytes"):
        registry.read(NAME, 1)
