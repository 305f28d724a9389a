"""Tests of a registry in a bucket: killed clients, outages, caches and changed objects."""

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import obstore
import pytest
from obstore.store import S3Store

from service.errors import BrokenModelError, ConflictError, PublishError, RegistryError
from service.inference.loaded_models import LoadedModels
from service.model.reference import ModelReference
from service.registry.location import open_registry
from service.registry.registry import Registry
from tests.fakes import load_fake, publish_fake
from tests.s3_server import BUCKET, Server, running_server

NAME = "push-indicator"
LOCATION = f"s3://{BUCKET}/models"
PATIENCE_S = 120.0  # bounds a hang and is not a measurement


@pytest.fixture(scope="module")
def shared_server() -> Iterator[Server]:
    """One S3 server for all tests of this file."""
    with running_server() as found:
        yield found


@pytest.fixture
def server(shared_server: Server, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Server:
    """The empty server, with its address and credentials in the environment."""
    shared_server.empty()
    for key, value in {**shared_server.environment, "CAZSL_CACHE": str(tmp_path / "cache")}.items():
        monkeypatch.setenv(key, value)
    return shared_server


@pytest.fixture
def registry(server: Server) -> Registry:
    """A registry with two versions, of which the first is the champion."""
    found = open_registry(LOCATION)
    publish_fake(found)
    publish_fake(found, alias=None)
    return found


@pytest.fixture
def bucket(server: Server) -> S3Store:
    """The bucket, opened without the registry."""
    return S3Store(BUCKET, prefix="models", endpoint=server.environment["AWS_ENDPOINT_URL"], allow_http=True)


def test_missing_home_folder_is_an_error_that_names_the_setting(
    server: Server, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A user without a home folder, as in a container, is asked to set CAZSL_CACHE."""

    def home() -> Path:
        """Raise the error that pathlib raises for such a user."""
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.delenv("CAZSL_CACHE")
    monkeypatch.setattr(Path, "home", home)
    with pytest.raises(RegistryError, match="this user has no home; set CAZSL_CACHE"):
        open_registry(LOCATION)


KILLED = """
import os, signal, sys
from pathlib import Path
import obstore
from service.registry.location import open_registry
from service.registry.registry import Registry
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

source = Registry(Path(sys.argv[4]))
act = {
    "push": lambda: registry.copy(source, "push-indicator", 3),
    "publish": lambda: publish_fake(registry, alias=None),
    "alias": lambda: registry.point_alias("push-indicator", "champion", 2),
    "remove": lambda: registry.remove("push-indicator", 2),
}[sys.argv[2]]
sys.setprofile(kill)
act()
sys.setprofile(None)
"""


def killed(project_root: Path, action: str, requests: int, source: Path) -> int:
    """Run an action in a process that is killed before its n-th request, and return its exit status."""
    return subprocess.run(
        [sys.executable, "-c", KILLED, LOCATION, action, str(requests), str(source)],
        cwd=project_root,
        env={**os.environ, "PYTHONPATH": str(project_root)},
        check=False,
        timeout=PATIENCE_S,
    ).returncode


@pytest.mark.parametrize(
    ("action", "before", "after"),
    [("publish", ([1, 2], 1), ([1, 2, 3], 1)), ("alias", ([1, 2], 1), ([1, 2], 2)), ("remove", ([1, 2], 1), ([1], 1))],
)
def test_a_client_killed_before_any_request_leaves_the_old_state_or_the_new_one(
    server: Server,
    project_root: Path,
    tmp_path: Path,
    action: str,
    before: tuple[list[int], int],
    after: tuple[list[int], int],
) -> None:
    """A client killed before its n-th request leaves the old or the new state.

    Every visible byte verifies, the next client continues, no number is used twice, and the history is complete.
    """
    seen, status, requests = [], -1, 0
    while status != 0:
        requests += 1
        server.empty()
        registry = open_registry(LOCATION)
        publish_fake(registry)
        publish_fake(registry, alias=None)
        status = killed(project_root, action, requests, tmp_path / "none")
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


def test_push_killed_before_any_request_is_finished_by_the_same_command(
    server: Server, project_root: Path, tmp_path: Path
) -> None:
    """A push that is killed before its n-th request leaves no version or a whole one, and its repetition completes it.

    The version then has its number, its bytes, its signature and both events. Content of another writer is not touched.
    """
    source = Registry(tmp_path / "source")
    for _ in range(3):
        publish_fake(source, alias=None)
    source.sign(NAME, 3, b"signature")
    whole = source.read(NAME, 3)
    status, requests, seen = -1, 0, []
    while status != 0:
        requests += 1
        server.empty()
        registry = open_registry(LOCATION)
        publish_fake(registry)
        status = killed(project_root, "push", requests, source.root)
        assert status in (0, -signal.SIGKILL)
        seen.append(registry.versions(NAME))
        for _ in range(2):
            assert registry.copy(source, NAME, 3) == whole
        assert registry.versions(NAME) == [1, 3]
        history = registry.history(NAME)
        assert history.problems == ()
        assert [event.to for event in history.events if event.what == "publish"] == [1, 3]
        assert history.has_signing(3)
        assert [finding for finding in registry.survey() if not finding.where.startswith("probe-")] == []
    assert requests > 10
    assert seen == sorted(seen)
    assert {tuple(versions) for versions in seen} == {(1,), (1, 3)}


def test_push_over_the_files_of_another_writer_is_a_conflict(
    registry: Registry, bucket: S3Store, tmp_path: Path
) -> None:
    """Files that another writer left under the number are not taken over. The error tells how to go on."""
    source = Registry(tmp_path / "source")
    for _ in range(3):
        publish_fake(source, alias=None)
    obstore.put(bucket, f"{NAME}/3/model.onnx", b"theirs")
    with pytest.raises(ConflictError, match=rf"choose another number, or delete {NAME}/3/ in the bucket"):
        registry.copy(source, NAME, 3)
    assert bytes(obstore.get(bucket, f"{NAME}/3/model.onnx").bytes()) == b"theirs"


@pytest.mark.parametrize("lost", ["first", "last", "state", "appended"])
def test_history_in_a_bucket_is_not_cut_unseen(registry: Registry, bucket: S3Store, lost: str) -> None:
    """A missing event, a state that was put back, and an added event are problems of the history."""
    old = bytes(obstore.get(bucket, f"{NAME}/state.json").bytes())
    registry.point_alias(NAME, "champion", 2)
    registry.point_alias(NAME, "champion", 1)
    assert registry.history(NAME).problems == ()
    key = {"first": "000000001", "last": "000000004", "appended": "000000009"}.get(lost)
    if lost == "state":
        obstore.put(bucket, f"{NAME}/state.json", old)
    elif lost == "appended":
        obstore.put(bucket, f"{NAME}/history/{key}.json", b"{}")
    else:
        obstore.delete(bucket, f"{NAME}/history/{key}.json")
    assert [problem for problem in registry.history(NAME).problems if "events" in problem]


def test_writer_refuses_a_model_whose_state_is_missing(registry: Registry, bucket: S3Store) -> None:
    """A model that lost its state is not begun anew: its versions would become invisible."""
    obstore.delete(bucket, f"{NAME}/state.json")
    for change in (lambda: publish_fake(registry, alias=None), lambda: registry.remove(NAME, 2)):
        with pytest.raises(RegistryError, match=r"state\.json is missing, although there is a history"):
            change()


def test_every_object_outside_of_the_layout_is_named(registry: Registry, bucket: S3Store) -> None:
    """An object that does not belong is named by the survey, wherever it lies."""
    registry.sign(NAME, 1, b"signature")
    registry.remove(NAME, 2)
    assert registry.survey() == []
    strays = {
        "readme.txt": "readme.txt",
        "probe-123": "probe-123",
        f"{NAME}/notes": f"{NAME}/notes",
        f"{NAME}/aliases/champion": f"{NAME}/aliases",
        f"{NAME}/1/extra.bin": f"{NAME}/1/extra.bin",
        f"{NAME}/2/model.onnx": f"{NAME}/2",
        f"{NAME}/7/model.onnx": f"{NAME}/7",
        f"{NAME}/history/1.json": f"{NAME}/history/1.json",
        f"{NAME}/signatures/7": f"{NAME}/signatures/7",
    }
    for key in strays:
        obstore.put(bucket, key, b"")
    assert {finding.where for finding in registry.survey()} == set(strays.values())


def test_outage_keeps_models_loaded_and_a_restart_serves_from_the_cache(server: Server, registry: Registry) -> None:
    """During an outage, loaded models stay, a new process serves cached versions, and readiness reports the cause."""
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
        with pytest.raises(PublishError, match="no version was published"):
            publish_fake(registry, alias=None)
    finally:
        server.start()


def test_outage_without_a_cache_is_an_error(server: Server, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """A store that cannot be reached is not reported as an empty registry."""
    monkeypatch.setenv("CAZSL_CACHE", str(tmp_path / "empty"))
    registry = open_registry(LOCATION)
    server.stop()
    try:
        with pytest.raises(RegistryError, match="cannot be listed"):
            registry.names()
    finally:
        server.start()


def test_version_is_downloaded_once(registry: Registry, bucket: S3Store, monkeypatch: pytest.MonkeyPatch) -> None:
    """A restarted process reads a version from the cache, because its files never change."""
    registry.read(NAME, 1)
    for file in ("model.onnx", "card.md"):
        obstore.delete(bucket, f"{NAME}/1/{file}")
    assert open_registry(LOCATION).read(NAME, 1).model == b"fine"


@pytest.mark.parametrize("file", ["manifest.json", "model.onnx", "card.md"])
def test_changed_cache_file_is_deleted_and_downloaded_again(registry: Registry, tmp_path: Path, file: str) -> None:
    """A cached file with one changed bit is deleted, and the version is downloaded again."""
    registry.read(NAME, 1)
    (path,) = (tmp_path / "cache").glob(f"*/{NAME}/1/{file}")
    content = bytearray(path.read_bytes())
    content[0] ^= 1
    path.write_bytes(content)
    assert open_registry(LOCATION).read(NAME, 1).model == b"fine"
    assert path.read_bytes() != bytes(content)


@pytest.mark.parametrize("file", ["manifest.json", "model.onnx", "card.md"])
def test_changed_object_is_refused_by_its_name_until_it_is_restored(
    registry: Registry, bucket: S3Store, file: str
) -> None:
    """An object with a changed bit is refused by its name, and is read again once the store has the right bytes."""
    right = bytes(obstore.get(bucket, f"{NAME}/2/{file}").bytes())
    obstore.put(bucket, f"{NAME}/2/{file}", right[:-1] + bytes([right[-1] ^ 1]))
    with pytest.raises(BrokenModelError, match=file.replace(".", r"\.")):
        registry.read(NAME, 2)
    obstore.put(bucket, f"{NAME}/2/{file}", right)
    assert registry.read(NAME, 2).model == b"fine"


def test_object_over_its_size_limit_is_refused(registry: Registry, bucket: S3Store) -> None:
    """The size of an object is checked before it is read."""
    obstore.put(bucket, f"{NAME}/2/card.md", bytes((1 << 20) + 1))
    with pytest.raises(BrokenModelError, match=r"card\.md: more than 1048576 bytes"):
        registry.read(NAME, 2)


def test_file_outside_the_manifest_is_refused(registry: Registry, bucket: S3Store) -> None:
    """A version with a file that its manifest does not list is refused, as in a folder."""
    obstore.put(bucket, f"{NAME}/2/extra.bin", b"")
    with pytest.raises(BrokenModelError, match="not in the manifest"):
        registry.read(NAME, 2)


@pytest.mark.parametrize("content", [b"", b"{}", b"[]", b"\xff", b'{"versions": ["x"]}'])
def test_invalid_state_file_is_refused(registry: Registry, bucket: S3Store, content: bytes) -> None:
    """An invalid state file is an error, not an empty state."""
    obstore.put(bucket, f"{NAME}/state.json", content)
    with pytest.raises(RegistryError, match="not the state of a model"):
        registry.versions(NAME)
    with pytest.raises(RegistryError):
        publish_fake(registry, alias=None)


def test_incomplete_version_is_reported_and_never_visible(registry: Registry, bucket: S3Store) -> None:
    """A model file that no state names is reported, stays invisible, and keeps its number from being used."""
    obstore.put(bucket, f"{NAME}/3/model.onnx", b"half")
    assert registry.versions(NAME) == [1, 2]
    assert [finding.where for finding in registry.survey()] == [f"{NAME}/3"]
    assert publish_fake(registry, alias=None) == 4


def test_store_without_conditional_writes_is_refused(registry: Registry, monkeypatch: pytest.MonkeyPatch) -> None:
    """A store that ignores conditions is refused before the first write."""
    put = obstore.put
    monkeypatch.setattr(obstore, "put", lambda store, key, content, mode=None: put(store, key, content))
    with pytest.raises(RegistryError, match="does not support conditional writes"):
        publish_fake(open_registry(LOCATION), alias=None)


@pytest.mark.parametrize(
    "location",
    ["http://bucket/models", "ftp://x", "s3://", "s3://b\n/x", "s3://models/../x", "s3://models/a//b", "s3://%/x"],
)
def test_invalid_location_is_an_error(server: Server, location: str) -> None:
    """A location that is neither a folder nor a bucket is a RegistryError."""
    with pytest.raises(RegistryError):
        open_registry(location).names()
