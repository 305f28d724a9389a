"""Tests of signatures: only versions signed by a trusted key are read."""

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
    """Make a private and a public key with the commands in the help of ``cazsl models sign``."""
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


def requiring_signatures(registry: Registry, *keys: Path) -> Registry:
    """Open the same registry so that a signature by one of these keys is required."""
    return Registry(registry.root, trusted_keys(":".join(map(str, keys))))


def test_version_signed_by_a_trusted_key_is_read(registry: Registry, tmp_path: Path) -> None:
    """A version signed by one of several trusted keys is read."""
    private, public = key_pair(tmp_path, "ours")
    _, other = key_pair(tmp_path, "other")
    registry.sign(NAME, 1, sign(registry.read(NAME, 1).files, private))
    assert requiring_signatures(registry, other, public).read(NAME, 1).model == b"fine"


def test_version_without_a_valid_signature_is_refused(registry: Registry, tmp_path: Path) -> None:
    """A version with no signature, one by another key, one of another version, or noise is refused."""
    private, public = key_pair(tmp_path, "ours")
    stranger, _ = key_pair(tmp_path, "stranger")
    reader = requiring_signatures(registry, public)
    files = registry.read(NAME, 1).files
    with pytest.raises(BrokenModelError, match="signature: there is none"):
        reader.read(NAME, 1)
    for signature in (sign(files, stranger), sign(registry.read(NAME, 2).files, private), b"{}", b"\xff"):
        registry.sign(NAME, 1, signature)
        with pytest.raises(BrokenModelError, match="signature: not made by one of the 1 trusted keys"):
            reader.read(NAME, 1)
    registry.sign(NAME, 1, sign(files, private))
    assert reader.read(NAME, 1).model == b"fine"


@pytest.mark.parametrize("file", ["manifest.json", "model.onnx", "card.md"])
def test_signature_covers_every_byte(registry: Registry, tmp_path: Path, file: str) -> None:
    """A signature is invalid for files with a changed byte or an additional file."""
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


def test_service_that_requires_signatures_serves_signed_versions(registry: Registry, tmp_path: Path) -> None:
    """An unsigned version is reported by its name. Once it is signed, the next poll serves it."""
    private, public = key_pair(tmp_path, "ours")
    models = LoadedModels(requiring_signatures(registry, public), load_fake)
    models.refresh()
    assert any("push-indicator@1 is broken and not served: signature" in text for text in models.snapshot.problems)
    for version in (1, 2):
        registry.sign(NAME, version, sign(registry.read(NAME, version).files, private))
    models.refresh()
    assert (models.snapshot.versions(NAME), models.snapshot.problems) == ([1, 2], ())


def test_invalid_keys_are_errors(registry: Registry, tmp_path: Path) -> None:
    """A key that cannot be read, or is not of the needed kind, is an error before the service starts."""
    private, _ = key_pair(tmp_path, "ours")
    assert trusted_keys("") is None
    with pytest.raises(RegistryError, match="cannot be read"):
        trusted_keys(str(tmp_path / "gone.pem"))
    with pytest.raises(RegistryError, match="not a public key"):
        trusted_keys(str(private))
    with pytest.raises(RegistryError, match="cannot sign"):
        sign({}, tmp_path / "gone.pem")
