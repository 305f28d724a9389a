"""Signed versions: the right key and the right bytes, or nothing."""

import subprocess
from pathlib import Path

import pytest

from service.errors import BrokenModelError, RegistryError
from service.inference.loaded_models import LoadedModels
from service.registry.location import trusted_keys
from service.registry.registry import Registry
from service.registry.signing import sign
from tests.fakes import load_fake, publish_fake

NAME = "push-indicator"


def key_pair(folder: Path, name: str) -> tuple[Path, Path]:
    """A private and a public key, as the help of ``cazsl models sign`` says to make them."""
    private, public = folder / f"{name}.pem", folder / f"{name}.pub"
    for command in (
        ["openssl", "ecparam", "-name", "prime256v1", "-genkey", "-noout", "-out", str(private)],
        ["openssl", "ec", "-in", str(private), "-pubout", "-out", str(public)],
    ):
        subprocess.run(command, check=True, capture_output=True)
    return private, public


@pytest.fixture
def registry(tmp_path: Path) -> Registry:
    """A registry of two versions."""
    found = Registry(tmp_path / "models")
    publish_fake(found)
    publish_fake(found, model=b"other", alias=None)
    return found


def demanding(registry: Registry, *keys: Path) -> Registry:
    """The same registry for whoever demands a signature by one of these keys."""
    return Registry(registry.root, trusted_keys(":".join(map(str, keys))))


def test_a_version_signed_by_a_trusted_key_is_read(registry: Registry, tmp_path: Path) -> None:
    """One of several keys is enough."""
    private, public = key_pair(tmp_path, "ours")
    _, other = key_pair(tmp_path, "other")
    registry.sign(NAME, 1, sign(registry.read(NAME, 1).files, private))
    assert demanding(registry, other, public).read(NAME, 1).model == b"fine"


def test_a_version_without_a_signature_by_a_trusted_key_is_refused(registry: Registry, tmp_path: Path) -> None:
    """None, somebody else's, another version's, and noise."""
    private, public = key_pair(tmp_path, "ours")
    stranger, _ = key_pair(tmp_path, "stranger")
    reader = demanding(registry, public)
    files = registry.read(NAME, 1).files
    with pytest.raises(BrokenModelError, match="signature: there is none"):
        reader.read(NAME, 1)
    for signature in (sign(files, stranger), sign(registry.read(NAME, 2).files, private), b"{}", b"\xff"):
        registry.sign(NAME, 1, signature)
        with pytest.raises(BrokenModelError, match="signature: by none of the 1 trusted keys"):
            reader.read(NAME, 1)
    registry.sign(NAME, 1, sign(files, private))
    assert reader.read(NAME, 1).model == b"fine"


@pytest.mark.parametrize("file", ["manifest.json", "model.onnx", "card.md"])
def test_a_signature_covers_every_byte(registry: Registry, tmp_path: Path, file: str) -> None:
    """Bytes that another manifest vouches for are not those that were signed."""
    private, public = key_pair(tmp_path, "ours")
    files = registry.read(NAME, 1).files
    signature = sign(files, private)
    keys = trusted_keys(str(public))
    assert keys is not None
    keys.check(files, signature)
    with pytest.raises(BrokenModelError, match="signature"):
        keys.check({**files, file: files[file] + b"x"}, signature)
    with pytest.raises(BrokenModelError, match="signature"):
        keys.check({**files, "extra": b""}, signature)


def test_a_service_that_demands_signatures_serves_what_is_signed(registry: Registry, tmp_path: Path) -> None:
    """An unsigned version is a problem with its name; signing it is noticed at the next look."""
    private, public = key_pair(tmp_path, "ours")
    models = LoadedModels(demanding(registry, public), load_fake)
    models.refresh()
    assert any("push-indicator@1 is broken and not served: signature" in text for text in models.snapshot.problems)
    for version in (1, 2):
        registry.sign(NAME, version, sign(registry.read(NAME, version).files, private))
    models.refresh()
    assert (models.snapshot.versions(NAME), models.snapshot.problems) == ([1, 2], ())


def test_keys_that_are_none_are_told(registry: Registry, tmp_path: Path) -> None:
    """A service that was told to demand signatures never starts without the means to."""
    private, _ = key_pair(tmp_path, "ours")
    assert trusted_keys("") is None
    with pytest.raises(RegistryError, match="cannot be read"):
        trusted_keys(str(tmp_path / "gone.pem"))
    with pytest.raises(RegistryError, match="not a public key"):
        trusted_keys(str(private))
    with pytest.raises(RegistryError, match="cannot sign"):
        sign({}, tmp_path / "gone.pem")
