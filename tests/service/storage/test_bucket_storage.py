"""A registry in a bucket whose clients die, whose server goes away, and whose objects are not what they were."""

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import obstore
import pytest
from obstore.store import S3Store

from service.errors import BrokenModelError, PublishError, RegistryError
from service.inference.loaded_models import LoadedModels
from service.model.reference import ModelReference
from service.registry.location import open_registry
from service.registry.registry import Registry
from tests.buckets import BUCKET, Server, running_server
from tests.fakes import load_fake, publish_fake

NAME = "push-indicator"
LOCATION = f"s3://{BUCKET}/models"
PATIENCE_S = 120.0  # bounds a hang, measures nothing


@pytest.fixture(scope="module")
def shared_server() -> Iterator[Server]:
    """One S3 server for all tests of this file."""
    with running_server() as found:
        yield found


@pytest.fixture
def server(shared_server: Server, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Server:
    """The server, empty, and known to the environment."""
    shared_server.empty()
    for key, value in {**shared_server.environment, "CAZSL_CACHE": str(tmp_path / "cache")}.items():
        monkeypatch.setenv(key, value)
    return shared_server


@pytest.fixture
def registry(server: Server) -> Registry:
    """A registry with two versions, the first being the champion."""
    found = open_registry(LOCATION)
    publish_fake(found)
    publish_fake(found, alias=None)
    return found


@pytest.fixture
def bucket(server: Server) -> S3Store:
    """The bucket as anybody with its keys has it."""
    return S3Store(BUCKET, prefix="models", endpoint=server.environment["AWS_ENDPOINT_URL"], allow_http=True)


def test_a_user_without_a_home_is_told_to_name_a_cache(server: Server, monkeypatch: pytest.MonkeyPatch) -> None:
    """As in a container, whose user has a number only."""

    def home() -> Path:
        """As pathlib has it for such a user."""
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.delenv("CAZSL_CACHE")
    monkeypatch.setattr(Path, "home", home)
    with pytest.raises(RegistryError, match="this user has no home; set CAZSL_CACHE"):
        open_registry(LOCATION)


KILLED = """
import os, signal, sys
import obstore
from service.registry.location import open_registry
from tests.fakes import publish_fake

registry = open_registry(sys.argv[1])
left = int(sys.argv[3])
REQUESTS = (obstore.put, obstore.get, obstore.head, obstore.delete, obstore.list_with_delimiter)

def kill(frame, event, function):
    global left
    if event == "c_call" and any(function is request for request in REQUESTS):
        left -= 1
        if left == 0:
            sys.setprofile(None)
            os.kill(os.getpid(), signal.SIGKILL)

act = {
    "publish": lambda: publish_fake(registry, alias=None),
    "alias": lambda: registry.point_alias("push-indicator", "champion", 2),
    "remove": lambda: registry.remove("push-indicator", 2),
}[sys.argv[2]]
sys.setprofile(kill)
act()
sys.setprofile(None)
"""


@pytest.mark.parametrize(
    ("action", "before", "after"),
    [("publish", ([1, 2], 1), ([1, 2, 3], 1)), ("alias", ([1, 2], 1), ([1, 2], 2)), ("remove", ([1, 2], 1), ([1], 1))],
)
def test_a_client_killed_before_any_request_leaves_the_old_state_or_the_new_one(
    server: Server, project_root: Path, action: str, before: tuple[list[int], int], after: tuple[list[int], int]
) -> None:
    """Every visible byte verifies, the next client goes on, no number comes twice, the history misses nothing."""
    seen, status, requests = [], -1, 0
    while status != 0:
        requests += 1
        server.empty()
        registry = open_registry(LOCATION)
        publish_fake(registry)
        publish_fake(registry, alias=None)
        command = [sys.executable, "-c", KILLED, LOCATION, action, str(requests)]
        status = subprocess.run(
            command,
            cwd=project_root,
            env={**os.environ, "PYTHONPATH": str(project_root)},
            check=False,
            timeout=PATIENCE_S,
        ).returncode
        assert status in (0, -signal.SIGKILL)
        state = registry.state(NAME)
        assert all(registry.read(NAME, version).model == b"fine" for version in state.versions)
        seen.append((sorted(state.versions), state.aliases["champion"]))
        assert publish_fake(registry, alias=None) > max(state.versions | state.removed)
        history = registry.history(NAME)
        assert history.problems == ()
        assert history.state() == registry.state(NAME)
    assert requests > 5
    turn = seen.index(after)
    assert seen == [before] * turn + [after] * (len(seen) - turn)
    assert turn > 0


def test_an_outage_unloads_nothing_and_a_restart_in_it_serves_from_the_cache(
    server: Server, registry: Registry
) -> None:
    """What was read once is served again by a new process while the store is away; readiness says so."""
    models = LoadedModels(registry, load_fake)
    models.refresh()
    server.stop()
    try:
        models.refresh()
        assert models.snapshot.find(ModelReference.parse(NAME)).manifest.version == 1
        assert "cannot be reached" in models.snapshot.problems[0]
        restarted = LoadedModels(open_registry(LOCATION), load_fake)
        restarted.refresh()
        assert restarted.snapshot.versions(NAME) == [1, 2]
        assert restarted.snapshot.find(ModelReference.parse(NAME)).manifest.version == 1
        assert "cannot be reached" in restarted.snapshot.problems[0]
        with pytest.raises(PublishError, match="nothing was published"):
            publish_fake(registry, alias=None)
    finally:
        server.start()


def test_without_a_cache_an_outage_is_an_error(server: Server, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Unknown is not the same as empty."""
    monkeypatch.setenv("CAZSL_CACHE", str(tmp_path / "nothing"))
    registry = open_registry(LOCATION)
    server.stop()
    try:
        with pytest.raises(RegistryError, match="cannot be listed"):
            registry.names()
    finally:
        server.start()


def test_a_version_is_fetched_once(registry: Registry, bucket: S3Store, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its files never change: a restart reads them from the cache, compared as if they came from the store."""
    registry.read(NAME, 1)
    for file in ("model.onnx", "card.md"):
        obstore.delete(bucket, f"{NAME}/1/{file}")
    assert open_registry(LOCATION).read(NAME, 1).model == b"fine"


@pytest.mark.parametrize("file", ["manifest.json", "model.onnx", "card.md"])
def test_a_cache_that_holds_other_bytes_is_not_believed(registry: Registry, tmp_path: Path, file: str) -> None:
    """Wrong bytes are thrown away and fetched again."""
    registry.read(NAME, 1)
    (path,) = (tmp_path / "cache").glob(f"*/{NAME}/1/{file}")
    content = bytearray(path.read_bytes())
    content[0] ^= 1
    path.write_bytes(content)
    assert open_registry(LOCATION).read(NAME, 1).model == b"fine"
    assert path.read_bytes() != bytes(content)


@pytest.mark.parametrize("file", ["manifest.json", "model.onnx", "card.md"])
def test_an_object_that_was_changed_is_refused_by_its_name_and_can_be_mended(
    registry: Registry, bucket: S3Store, file: str
) -> None:
    """The cache does not keep wrong bytes alive once the store is right again."""
    right = bytes(obstore.get(bucket, f"{NAME}/2/{file}").bytes())
    obstore.put(bucket, f"{NAME}/2/{file}", right[:-1] + bytes([right[-1] ^ 1]))
    with pytest.raises(BrokenModelError, match=file.replace(".", r"\.")):
        registry.read(NAME, 2)
    obstore.put(bucket, f"{NAME}/2/{file}", right)
    assert registry.read(NAME, 2).model == b"fine"


def test_an_object_larger_than_its_limit_is_not_fetched(registry: Registry, bucket: S3Store) -> None:
    """Sizes are bounded before reading, in a bucket too."""
    obstore.put(bucket, f"{NAME}/2/card.md", bytes((1 << 20) + 1))
    with pytest.raises(BrokenModelError, match=r"card\.md: more than 1048576 bytes"):
        registry.read(NAME, 2)


def test_a_file_too_many_is_refused(registry: Registry, bucket: S3Store) -> None:
    """As in a folder."""
    obstore.put(bucket, f"{NAME}/2/extra.bin", b"")
    with pytest.raises(BrokenModelError, match="not in the manifest"):
        registry.read(NAME, 2)


@pytest.mark.parametrize("content", [b"", b"{}", b"[]", b"\xff", b'{"versions": ["x"]}'])
def test_a_state_that_is_none_is_refused(registry: Registry, bucket: S3Store, content: bytes) -> None:
    """Never taken for an empty one."""
    obstore.put(bucket, f"{NAME}/state.json", content)
    with pytest.raises(RegistryError, match="not a state"):
        registry.versions(NAME)
    with pytest.raises(RegistryError):
        publish_fake(registry, alias=None)


def test_what_a_dead_publisher_left_is_noted_and_never_visible(registry: Registry, bucket: S3Store) -> None:
    """A model file without a state is a number that nobody gets."""
    obstore.put(bucket, f"{NAME}/3/model.onnx", b"half")
    assert registry.versions(NAME) == [1, 2]
    assert [finding.where for finding in registry.survey()] == [f"{NAME}/3"]
    assert publish_fake(registry, alias=None) == 4


def test_a_store_that_heeds_no_conditions_is_refused(registry: Registry, monkeypatch: pytest.MonkeyPatch) -> None:
    """Better no change than one that could overwrite another."""
    put = obstore.put
    monkeypatch.setattr(obstore, "put", lambda store, key, content, mode=None: put(store, key, content))
    with pytest.raises(RegistryError, match="does not heed conditional writes"):
        publish_fake(open_registry(LOCATION), alias=None)


@pytest.mark.parametrize("location", ["http://bucket/models", "ftp://x", "s3://"])
def test_a_location_that_cannot_be_one_is_told(server: Server, location: str) -> None:
    """One line that says what a location is."""
    with pytest.raises(RegistryError):
        open_registry(location).names()
