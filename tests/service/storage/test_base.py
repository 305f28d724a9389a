"""Tests of the promises of every storage, run against a folder and against a bucket."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from multiprocessing.pool import ThreadPool
from pathlib import Path

import pytest

from service.errors import BrokenModelError, ConflictError, InUseError, RegistryError, UnknownModelError
from service.model.reference import ModelReference
from service.registry.location import open_registry
from service.registry.registry import NOWHERE, Registry
from tests.fakes import draft_manifest, publish_fake
from tests.s3_server import BUCKET, Server, running_server

NAME = "push-indicator"


@pytest.fixture(scope="module")
def server() -> Iterator[Server]:
    """One S3 server for all tests of this file."""
    with running_server() as found:
        yield found


@pytest.fixture(params=["folder", "bucket"])
def place(request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str], Registry]:
    """Return a function that opens a registry by name, as a new process with an empty cache would."""
    opened = 0

    def folder(name: str) -> Registry:
        """Open a registry in a folder."""
        return open_registry(str(tmp_path / name))

    def bucket(name: str) -> Registry:
        """Open a registry in a prefix of a bucket, with a cache of its own."""
        nonlocal opened
        opened += 1
        monkeypatch.setenv("CAZSL_CACHE", str(tmp_path / f"cache-{opened}"))
        return open_registry(f"s3://{BUCKET}/{name}")

    if request.param == "folder":
        return folder
    server: Server = request.getfixturevalue("server")
    server.empty()
    for key, value in server.environment.items():
        monkeypatch.setenv(key, value)
    return bucket


@pytest.fixture
def registry(place: Callable[[str], Registry]) -> Registry:
    """A registry with one model of two versions, of which the first is the champion."""
    found = place("models")
    publish_fake(found)
    publish_fake(found, alias=None)
    return found


def test_published_version_is_read_by_every_process(registry: Registry, place: Callable[[str], Registry]) -> None:
    """A published version has the same manifest, model and card in this process and in another."""
    for reader in (registry, place("models"), registry):
        found = reader.read(NAME, 1)
        assert (found.model, found.card, found.manifest.version) == (b"fine", f"# {NAME}\n", 1)
        assert (reader.names(), reader.versions(NAME), reader.aliases(NAME)) == ([NAME], [1, 2], {"champion": 1})
        assert reader.resolve(ModelReference.parse(NAME)) == 1


def test_version_number_is_never_used_twice(registry: Registry, place: Callable[[str], Registry]) -> None:
    """A version number is not used again after its removal, even by another process."""
    registry.remove(NAME, 2)
    assert publish_fake(place("models"), alias=None) == 3
    registry.remove(NAME, 3)
    assert publish_fake(registry, alias=None) == 4
    assert place("models").versions(NAME) == [1, 4]
    with pytest.raises(ConflictError, match="never used again"):
        registry.state(NAME).free_number(3)


def test_removed_version_cannot_be_read_or_named(registry: Registry, place: Callable[[str], Registry]) -> None:
    """A removed version cannot be read, named or removed again, even by a process that has it in its cache."""
    other = place("models")
    other.read(NAME, 2)
    registry.remove(NAME, 2)
    for reader in (registry, other):
        with pytest.raises(BrokenModelError):
            reader.read(NAME, 2)
        with pytest.raises(BrokenModelError):
            reader.point_alias(NAME, "champion", 2)
        with pytest.raises(UnknownModelError):
            reader.remove(NAME, 2)


def test_version_with_an_alias_is_not_removed(registry: Registry) -> None:
    """Removing a version that an alias names is an error with the alias. It works once the alias points elsewhere."""
    with pytest.raises(InUseError, match="named by champion"):
        registry.remove(NAME, 1)
    registry.point_alias(NAME, "champion", 2)
    registry.remove(NAME, 1)
    assert registry.versions(NAME) == [2]


def test_alias_moves_only_from_the_expected_version(registry: Registry, place: Callable[[str], Registry]) -> None:
    """Of two operators who both expect version 1, the second gets a conflict, and the alias stays."""
    publish_fake(registry, alias=None)
    other = place("models")
    registry.point_alias(NAME, "champion", 2, expect=1)
    with pytest.raises(ConflictError, match="names 2, but 1 was expected; the alias stays"):
        other.point_alias(NAME, "champion", 3, expect=1)
    with pytest.raises(ConflictError, match="names 2, but no version was expected"):
        other.point_alias(NAME, "champion", 3, expect=NOWHERE)
    other.point_alias(NAME, "canary", 3, expect=NOWHERE)
    assert registry.aliases(NAME) == {"canary": 3, "champion": 2}


def test_exactly_one_of_six_concurrent_alias_moves_succeeds(
    registry: Registry, place: Callable[[str], Registry]
) -> None:
    """Of six concurrent moves with the same expectation, exactly one succeeds."""
    clients = [place("models") for _ in range(6)]

    def move(client: Registry) -> bool:
        try:
            client.point_alias(NAME, "champion", 2, expect=1)
        except ConflictError:
            return False
        return True

    with ThreadPool(6) as pool:
        assert sorted(pool.map(move, clients)) == [False] * 5 + [True]


def test_concurrent_publishers_get_distinct_numbers(place: Callable[[str], Registry]) -> None:
    """Four concurrent publishers make twelve whole versions with distinct numbers, all recorded in the history."""
    clients = [place("models") for _ in range(4)]
    with ThreadPool(4) as pool:
        versions = pool.map(lambda number: publish_fake(clients[number % 4], alias=None), range(12))
    registry = place("models")
    assert len(set(versions)) == 12
    assert sorted(versions) == registry.versions(NAME)
    assert all(registry.read(NAME, version).model == b"fine" for version in versions)
    history = registry.history(NAME)
    assert (history.problems, {event.to for event in history.events}) == ((), set(versions))


def test_concurrent_removal_and_alias_move_leave_no_dangling_alias(
    place: Callable[[str], Registry], registry: Registry
) -> None:
    """Of a concurrent removal and alias move of one version, the second is refused."""
    clients = [place("models"), place("models")]

    def remove(version: int) -> None:
        clients[0].remove(NAME, version)

    def name(version: int) -> None:
        clients[1].point_alias(NAME, "canary", version)

    for _ in range(5):
        version = publish_fake(registry, alias=None)
        with ThreadPool(2) as pool:
            results = [pool.apply_async(remove, (version,)), pool.apply_async(name, (version,))]
            failures = [not _succeeds(result.get) for result in results]
        state = registry.state(NAME)
        assert set(state.aliases.values()) <= state.versions
        assert any(failures)
        if "canary" in state.aliases:
            registry.drop_alias(NAME, "canary")


def _succeeds(action: Callable[[], object]) -> bool:
    try:
        action()
    except RegistryError:
        return False
    return True


def test_history_records_every_change(registry: Registry) -> None:
    """A history records user, time, reason, old and new version of every change, in an unbroken chain."""
    registry.point_alias(NAME, "champion", 2, reason="better on circles")
    registry.remove(NAME, 1, reason="old")
    history = registry.history(NAME)
    found = [(event.what, event.before, event.to, event.reason) for event in history.events]
    assert found == [
        ("publish", None, 1, None),
        ("alias champion", None, 1, None),
        ("publish", None, 2, None),
        ("alias champion", 1, 2, "better on circles"),
        ("remove", 1, None, "old"),
    ]
    assert history.problems == ()
    assert all(event.who and event.time and event.previous for event in history.events)
    assert history.state() == replace(registry.state(NAME), aliases={"champion": 2})
    assert registry.unrecorded(NAME) == ()


def test_version_of_an_alias_at_an_instant_is_known(registry: Registry) -> None:
    """The version of an alias at an instant comes from the history. It is None before the first move."""
    now = datetime.now(UTC) + timedelta(seconds=2)
    assert registry.alias_at(NAME, "champion", now) == 1
    assert registry.alias_at(NAME, "champion", now - timedelta(days=1)) is None
    assert registry.alias_at(NAME, "canary", now) is None


def test_fingerprint_changes_with_every_change(registry: Registry) -> None:
    """A fingerprint changes when a version is published, signed or removed, and when an alias moves or is dropped."""
    seen = {registry.fingerprint()}
    changes: tuple[Callable[[], object], ...] = (
        lambda: publish_fake(registry, alias=None),
        lambda: registry.point_alias(NAME, "canary", 2),
        lambda: registry.sign(NAME, 2, b"signature"),
        lambda: registry.drop_alias(NAME, "canary"),
        lambda: registry.remove(NAME, 2),
    )
    for count, change in enumerate(changes, start=2):
        change()
        seen.add(registry.fingerprint())
        assert len(seen) == count


def test_signature_is_added_without_changing_the_version(registry: Registry) -> None:
    """A signature can be added later, and changes no byte of the version that it signs."""
    before = registry.read(NAME, 1)
    assert before.signature is None
    registry.sign(NAME, 1, b"signature")
    assert registry.read(NAME, 1) == replace(before, signature=b"signature")


def test_missing_model_alias_or_version_is_unknown(registry: Registry) -> None:
    """A request for a missing model, alias or version raises UnknownModelError."""
    for ask in (
        lambda: registry.history("absent"),
        lambda: registry.remove("absent", 1),
        lambda: registry.drop_alias(NAME, "canary"),
        lambda: registry.remove(NAME, 9),
    ):
        with pytest.raises(UnknownModelError):
            ask()


def test_copy_between_registries_is_equal_to_the_byte(
    registry: Registry, place: Callable[[str], Registry], tmp_path: Path
) -> None:
    """A copied version keeps its bytes, number and signature, in each direction and when it is repeated."""
    registry.sign(NAME, 2, b"signature")
    folder, other = Registry(tmp_path / "copy"), place("other")
    for destination, source in ((folder, registry), (other, folder), (other, registry)):
        destination.copy(source, NAME, 2)
        assert destination.read(NAME, 2) == registry.read(NAME, 2)
        assert (destination.versions(NAME), destination.aliases(NAME)) == ([2], {})
    assert publish_fake(other, alias=None) == 3


def test_copy_never_replaces_a_version(registry: Registry, place: Callable[[str], Registry]) -> None:
    """A copy is refused if its number names another version, or was removed, in the destination."""
    registry.sign(NAME, 2, b"signature")
    other = place("other")
    other.publish(draft_manifest(), b"other", "card")
    other.publish(draft_manifest(), b"other", "card")
    with pytest.raises(ConflictError, match="another version"):
        other.copy(registry, NAME, 2)
    assert other.read(NAME, 2).signature is None
    other.remove(NAME, 2)
    with pytest.raises(ConflictError, match="never used again"):
        other.copy(registry, NAME, 2)
    assert other.read(NAME, 1).model == b"other"
