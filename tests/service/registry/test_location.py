"""Tests of registry locations and of missing extras."""

import sys
from pathlib import Path

import pytest

from service.errors import RegistryError
from service.registry.location import open_registry, trusted_keys
from tests.fakes import publish_fake


def test_folder_is_opened_without_reading_it(tmp_path: Path) -> None:
    """A folder that does not exist yet can be opened, and is created by the first publish."""
    registry = open_registry(str(tmp_path / "models"))
    assert not registry.root.exists()
    publish_fake(registry)
    assert registry.names() == ["push-indicator"]


@pytest.mark.parametrize("location", ["http://bucket/models", "ftp://x", "s3://"])
def test_other_addresses_are_refused(location: str) -> None:
    """An address that is neither a folder nor a bucket is an error that names both forms."""
    with pytest.raises(RegistryError, match=r"s3://bucket/prefix"):
        open_registry(location)


def test_missing_extra_for_buckets_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    """A bucket without the extra ``s3`` is an error that says how to install it."""
    monkeypatch.setitem(sys.modules, "service.storage.bucket_storage", None)
    with pytest.raises(RegistryError, match=r"pip install 'cazsl\[s3\]'"):
        open_registry("s3://bucket/models")


def test_missing_extra_for_signatures_names_the_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Trusted keys without the extra ``signing`` are an error that says how to install it."""
    monkeypatch.setitem(sys.modules, "service.registry.signing", None)
    with pytest.raises(RegistryError, match=r"pip install 'cazsl\[signing\]'"):
        trusted_keys(str(tmp_path / "public.pem"))
