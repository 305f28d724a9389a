"""What every storage promises, held for a folder and for a bucket alike."""

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
from tests.buckets import BUCKET, Server, running_server
from tests.fakes import draft_manifest, publish_fake

NAME = "push-indicator"


@pytest.fixture(scope="module")
def server() -> Iterator[Server]:
    """One S3 server for all tests of this file."""
    with running_server() as found:
        yield found


@pytest.fixture(params=["folder", "bucket"])
def place(request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str], Registry]:
    """Opens registries by name, each time as a new process with an empty cache would."""
    opened = 0

    def folder(name: str) -> Registry:
        """A folder."""
        return open_registry(str(tmp_path / name))

    def bucket(name: str) -> Registry:
        """A prefix of a bucket, with a cache of its own."""
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
    """A registry with one model of two versions, the first being its champion."""
    found = place("models")
    publish_fake(found)
    publish_fake(found, alias=None)
    return found


def test_what_was_published_is_what_anybody_reads(registry: Registry, place: Callable[[str], Registry]) -> None:
    """Manifest, model and card, through this process and through another."""
    for reader in (registry, place("models"), registry):
        found = reader.read(NAME, 1)
        assert (found.model, found.card, found.manifest.version) == (b"fine", f"# {NAME}\n", 1)
        assert (reader.names(), reader.versions(NAME), reader.aliases(NAME)) == ([NAME], [1, 2], {"champion": 1})
        assert reader.resolve(ModelReference.parse(NAME)) == 1


def test_a_number_is_never_given_twice(registry: Registry, place: Callable[[str], Registry]) -> None:
    """Not even the newest after its removal, and not by anybody."""
    registry.remove(NAME, 2)
    assert publish_fake(place("models"), alias=None) == 3
    registry.remove(NAME, 3)
    assert publish_fake(registry, alias=None) == 4
    assert place("models").versions(NAME) == [1, 4]
    with pytest.raises(ConflictError, match="spent"):
        registry.state(NAME).free(3)


def test_a_removed_version_cannot_be_read_nor_named(registry: Registry, place: Callable[[str], Registry]) -> None:
    """Gone for whoever had it in a cache, too."""
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


def test_what_an_alias_names_is_not_removed(registry: Registry) -> None:
    """The error says which alias; once it points elsewhere, removal works."""
    with pytest.raises(InUseError, match="named by champion"):
        registry.remove(NAME, 1)
    registry.point_alias(NAME, "champion", 2)
    registry.remove(NAME, 1)
    assert registry.versions(NAME) == [2]


def test_an_alias_moves_only_from_what_the_operator_saw(registry: Registry, place: Callable[[str], Registry]) -> None:
    """Two operators saw version 1; the second is told, and nothing is overwritten unseen."""
    publish_fake(registry, alias=None)
    other = place("models")
    registry.point_alias(NAME, "champion", 2, expect=1)
    with pytest.raises(ConflictError, match="names 2, not 1; it stays"):
        other.point_alias(NAME, "champion", 3, expect=1)
    with pytest.raises(ConflictError, match="names 2, not nothing"):
        other.point_alias(NAME, "champion", 3, expect=NOWHERE)
    other.point_alias(NAME, "canary", 3, expect=NOWHERE)
    assert registry.aliases(NAME) == {"canary": 3, "champion": 2}


def test_of_many_who_saw_the_same_exactly_one_moves_an_alias(
    registry: Registry, place: Callable[[str], Registry]
) -> None:
    """Compare-and-set at once, from processes' worth of clients."""
    clients = [place("models") for _ in range(6)]

    def move(client: Registry) -> bool:
        try:
            client.point_alias(NAME, "champion", 2, expect=1)
        except ConflictError:
            return False
        return True

    with ThreadPool(6) as pool:
        assert sorted(pool.map(move, clients)) == [False] * 5 + [True]


def test_publishers_at_once_get_a_number_each(place: Callable[[str], Registry]) -> None:
    """Twelve versions from four publishers: twelve whole versions, no number twice, every one in the history."""
    clients = [place("models") for _ in range(4)]
    with ThreadPool(4) as pool:
        versions = pool.map(lambda turn: publish_fake(clients[turn % 4], alias=None), range(12))
    registry = place("models")
    assert len(set(versions)) == 12
    assert sorted(versions) == registry.versions(NAME)
    assert all(registry.read(NAME, version).model == b"fine" for version in versions)
    history = registry.history(NAME)
    assert (history.problems, {event.to for event in history.events}) == ((), set(versions))


def test_removing_and_naming_at_once_never_leaves_an_alias_to_nothing(
    place: Callable[[str], Registry], registry: Registry
) -> None:
    """Whoever comes second is refused."""
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


def test_the_history_tells_everything_that_happened(registry: Registry) -> None:
    """Who, when, why, from and to, in a chain that holds."""
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


def test_what_an_alias_named_then_can_be_told(registry: Registry) -> None:
    """Now, and before anything was there."""
    now = datetime.now(UTC) + timedelta(seconds=2)
    assert registry.alias_at(NAME, "champion", now) == 1
    assert registry.alias_at(NAME, "champion", now - timedelta(days=1)) is None
    assert registry.alias_at(NAME, "canary", now) is None


def test_the_fingerprint_changes_with_every_change_and_only_then(registry: Registry) -> None:
    """Publish, move, sign, drop, remove."""
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


def test_a_signature_lies_beside_its_version(registry: Registry) -> None:
    """It can be added later, and changes not a byte of what it signs."""
    before = registry.read(NAME, 1)
    assert before.signature is None
    registry.sign(NAME, 1, b"signature")
    assert registry.read(NAME, 1) == replace(before, signature=b"signature")


def test_what_is_not_there_is_unknown(registry: Registry) -> None:
    """A model, an alias, a version; and a storage that does not exist is an error."""
    for ask in (
        lambda: registry.history("nobody"),
        lambda: registry.remove("nobody", 1),
        lambda: registry.drop_alias(NAME, "canary"),
        lambda: registry.remove(NAME, 9),
    ):
        with pytest.raises(UnknownModelError):
            ask()


def test_copies_between_registries_are_the_same_to_the_byte(
    registry: Registry, place: Callable[[str], Registry], tmp_path: Path
) -> None:
    """Number and signature included, there and back, and again without harm."""
    registry.sign(NAME, 2, b"signature")
    folder, other = Registry(tmp_path / "copy"), place("other")
    for destination, source in ((folder, registry), (other, folder), (other, registry)):
        destination.copy(source, NAME, 2)
        assert destination.read(NAME, 2) == registry.read(NAME, 2)
        assert (destination.versions(NAME), destination.aliases(NAME)) == ([2], {})
    assert publish_fake(other, alias=None) == 3


def test_a_copy_replaces_nothing(registry: Registry, place: Callable[[str], Registry]) -> None:
    """Another version of that number, or a number that is spent, stays what it is."""
    registry.sign(NAME, 2, b"signature")
    other = place("other")
    other.publish(draft_manifest(), b"other", "card")
    other.publish(draft_manifest(), b"other", "card")
    with pytest.raises(ConflictError, match="another version"):
        other.copy(registry, NAME, 2)
    assert other.read(NAME, 2).signature is None
    other.remove(NAME, 2)
    with pytest.raises(ConflictError, match="spent"):
        other.copy(registry, NAME, 2)
    assert other.read(NAME, 1).model == b"other"
