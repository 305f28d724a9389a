"""Hostile files in a registry: each is refused by its name, without a hang and without following a link."""

import os
import socket
from collections.abc import Callable
from pathlib import Path

import pytest

from service.errors import BrokenModelError, CazslError, RegistryError
from service.model.manifest import MAX_MANIFEST_BYTES
from service.registry.registry import Registry
from service.registry.verification import MAX_CARD_BYTES, MAX_MODEL_BYTES
from tests.fakes import publish_fake

NAME = "push-indicator"
FILES = ("manifest.json", "model.onnx", "card.md")


@pytest.fixture
def registry(tmp_path: Path) -> Registry:
    """Create a registry with one version."""
    found = Registry(tmp_path / "models")
    publish_fake(found)
    return found


def symlink(path: Path) -> None:
    """Replace a file by a symlink to its bytes. The link could point elsewhere later."""
    elsewhere = path.parents[3] / "elsewhere"
    path.rename(elsewhere)
    path.symlink_to(elsewhere)


def hard_link(path: Path) -> None:
    """Give a file a second name, through which its bytes can be changed."""
    os.link(path, path.parents[3] / "elsewhere")


def pipe(path: Path) -> None:
    """Replace a file by a pipe. Reading it would wait for ever."""
    path.unlink()
    os.mkfifo(path)


def unix_socket(path: Path) -> None:
    """Replace a file by a socket, which cannot be opened."""
    path.unlink()
    here = Path.cwd()
    os.chdir(path.parent)  # a socket's path has to be short
    try:
        with socket.socket(socket.AF_UNIX) as bound:
            bound.bind(path.name)
    finally:
        os.chdir(here)


def device(path: Path) -> None:
    """Replace a file by the device /dev/zero. Reading it would never end."""
    path.unlink()
    try:
        os.mknod(path, 0o20644, os.makedev(1, 5))  # /dev/zero
    except PermissionError:
        pytest.skip("no right to make a device")


def folder(path: Path) -> None:
    """Replace a file by a folder."""
    path.unlink()
    path.mkdir()


def huge(path: Path) -> None:
    """Extend a file to a sparse terabyte."""
    with path.open("r+b") as file:
        file.truncate(1 << 40)


ATTACKS: dict[str, tuple[Callable[[Path], None], str]] = {
    "symlink": (symlink, "a link; links are not followed"),
    "hard link": (hard_link, "a hard link"),
    "pipe": (pipe, "not a regular file"),
    "socket": (unix_socket, "not a regular file"),
    "device": (device, "not a regular file"),
    "folder": (folder, "not a regular file"),
    "huge": (huge, "more than"),
}


@pytest.mark.parametrize("file", FILES)
@pytest.mark.parametrize("attack", ATTACKS)
def test_a_file_that_is_not_a_plain_file_is_refused_by_its_name(registry: Registry, file: str, attack: str) -> None:
    """A file that is not a plain file is refused with its name and the reason."""
    change, refusal = ATTACKS[attack]
    change(registry.root / NAME / "1" / file)
    with pytest.raises(BrokenModelError, match=rf"{file}: {refusal}"):
        registry.read(NAME, 1)


@pytest.mark.parametrize(
    ("file", "limit"), list(zip(FILES, (MAX_MANIFEST_BYTES, MAX_MODEL_BYTES, MAX_CARD_BYTES), strict=True))
)
def test_a_file_over_its_limit_is_refused(registry: Registry, file: str, limit: int) -> None:
    """A file of one byte over the limit is refused with the limit, before any of it is read."""
    path = registry.root / NAME / "1" / file
    with path.open("r+b") as opened:
        opened.truncate(limit + 1)
    with pytest.raises(BrokenModelError, match=f"{file}: more than {limit} bytes"):
        registry.read(NAME, 1)


@pytest.mark.parametrize("attack", ["symlink", "hard link", "pipe", "device", "folder", "huge"])
def test_an_alias_that_is_not_a_plain_file_is_no_alias(registry: Registry, attack: str) -> None:
    """An alias that is not a plain file is left out of the aliases, and listing them does not hang."""
    path = registry.root / NAME / "aliases" / "champion"
    ATTACKS[attack][0](path)
    assert registry.aliases(NAME) == {}


@pytest.mark.parametrize("attack", ["symlink", "hard link", "pipe", "device", "folder"])
def test_a_history_that_is_not_a_plain_file_is_neither_read_nor_written(registry: Registry, attack: str) -> None:
    """A history that is not a plain file is refused. Through a link a publisher could write to any file of its user."""
    path = registry.root / NAME / "history.jsonl"
    victim = registry.root.parent / "victim"
    victim.write_bytes(path.read_bytes())
    if attack == "symlink":
        path.unlink()
        path.symlink_to(victim)
    elif attack == "hard link":
        path.unlink()
        os.link(victim, path)
    else:
        ATTACKS[attack][0](path)
    before = victim.read_bytes()
    with pytest.raises(CazslError):
        registry.history(NAME)
    with pytest.raises(CazslError):
        publish_fake(registry, alias=None)
    assert victim.read_bytes() == before
    assert registry.versions(NAME) == [1]


@pytest.mark.parametrize("what", ["", "1", "aliases"])
def test_a_folder_that_is_a_link_is_not_followed(registry: Registry, what: str) -> None:
    """A folder of a model, a version or aliases that is a link is refused, because it could leave the registry."""
    path = registry.root / NAME / what
    outside = registry.root.parent / "outside"
    path.rename(outside)
    path.symlink_to(outside)
    if what == "aliases":
        assert registry.aliases(NAME) == {}
        assert registry.state(NAME).faults["aliases"] == "not a plain folder; links are not followed"
        return
    with pytest.raises(RegistryError):
        registry.read(NAME, registry.aliases(NAME)["champion"])


def test_a_linked_model_is_not_listed(registry: Registry) -> None:
    """A model whose folder is a link is not listed."""
    (registry.root / "push-none").symlink_to(registry.root / NAME)
    assert registry.names() == [NAME]


def test_publishing_through_a_linked_model_is_refused(registry: Registry, tmp_path: Path) -> None:
    """Publishing to a model whose folder is a link is refused, and writes no file outside of the registry."""
    outside = tmp_path / "outside"
    outside.mkdir()
    (registry.root / "push-none").symlink_to(outside)
    with pytest.raises(CazslError):
        publish_fake(registry, "push-none")
    assert list(outside.iterdir()) == []


def test_signing_through_a_link_is_refused(registry: Registry, tmp_path: Path) -> None:
    """Signing into a folder that is a link is refused, and writes no file outside of the registry."""
    outside = tmp_path / "outside"
    outside.mkdir()
    (registry.root / NAME / "signatures").symlink_to(outside)
    with pytest.raises(CazslError):
        registry.sign(NAME, 1, b"x")
    assert list(outside.iterdir()) == []


@pytest.mark.parametrize("name", ["..", ".", "a/b", "/etc", "", "UPPER", "x" * 65, "a\x00b", "a\n", "é", "a b", "-a"])
def test_a_name_outside_of_the_allow_list_is_refused(registry: Registry, name: str) -> None:
    """Every operation of the registry refuses such a name before it reaches the file system."""
    for ask in (
        lambda: registry.versions(name),
        lambda: registry.read(name, 1),
        lambda: registry.point_alias(NAME, name, 1),
        lambda: registry.point_alias(name, "champion", 1),
        lambda: registry.remove(name, 1),
        lambda: registry.history(name),
    ):
        with pytest.raises(RegistryError, match="lower-case"):
            ask()


@pytest.mark.parametrize("extra", ["extra.bin", "model.onnx.data", ".hidden", "weights"])
def test_a_version_with_a_file_that_its_manifest_does_not_list_is_refused(registry: Registry, extra: str) -> None:
    """A version with a file that its manifest does not list is refused."""
    (registry.root / NAME / "1" / extra).write_bytes(b"")
    with pytest.raises(BrokenModelError, match="not in the manifest"):
        registry.read(NAME, 1)


@pytest.mark.parametrize("file", FILES)
def test_a_version_with_a_missing_file_is_refused(registry: Registry, file: str) -> None:
    """A version with a missing file is refused with the name of the file."""
    (registry.root / NAME / "1" / file).unlink()
    with pytest.raises(BrokenModelError, match=f"{file}: No such file"):
        registry.read(NAME, 1)
