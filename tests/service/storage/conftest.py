"""Fixtures of the tests of storages: a place for registries, in a folder and in a bucket."""

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from service.registry.location import open_registry
from service.registry.registry import Registry
from tests.s3_server import BUCKET, Server, running_server


@pytest.fixture(scope="module")
def server() -> Iterator[Server]:
    """One S3 server for all tests of a file."""
    with running_server() as found:
        yield found


@pytest.fixture
def folder_place(tmp_path: Path) -> Callable[[str], Registry]:
    """Return a function that opens a registry in a folder by name."""
    return lambda name: open_registry(str(tmp_path / name))


@pytest.fixture
def bucket_place(server: Server, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str], Registry]:
    """Return a function that opens a registry in a prefix of a bucket, as a new process with an empty cache would."""
    opened = 0
    server.empty()
    for key, value in server.environment.items():
        monkeypatch.setenv(key, value)

    def bucket(name: str) -> Registry:
        """Open a registry in a prefix of a bucket, with a cache of its own."""
        nonlocal opened
        opened += 1
        monkeypatch.setenv("CAZSL_CACHE", str(tmp_path / f"cache-{opened}"))
        return open_registry(f"s3://{BUCKET}/{name}")

    return bucket


@pytest.fixture(params=["folder", "bucket"])
def place(request: pytest.FixtureRequest) -> Callable[[str], Registry]:
    """Return a function that opens a registry by name, as a new process with an empty cache would."""
    found: Callable[[str], Registry] = request.getfixturevalue(f"{request.param}_place")
    return found
