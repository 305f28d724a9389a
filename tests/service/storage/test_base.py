"""Tests of the promises of every storage, run against a folder and against a bucket.

A fault is its own model's: all others are served and followed. Absence is no intent: only a recorded removal unloads.
"""

import contextlib
import errno
import functools
import os
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from multiprocessing.pool import ThreadPool
from pathlib import Path
from types import FrameType

import obstore
import pytest
from fastapi.testclient import TestClient

from service.app import create_app
from service.errors import BrokenModelError, ConflictError, InUseError, RegistryError, UnknownModelError
from service.inference.loaded_models import LoadedModels
from service.model.reference import ModelReference
from service.model.tensors import ContextKind
from service.registry.doctor import examine
from service.registry.registry import NOWHERE, Registry
from service.settings import Settings
from service.storage.base import RegistryFinding
from service.storage.folder_storage import FolderStorage
from service.storage.history import ModelState, unrecorded
from tests.fakes import draft_manifest, load_fake, publish_fake
from tests.service.storage.faults import (
    BUCKET_FAULTS,
    BUCKET_LOSSES,
    BUCKET_STRANGERS,
    FOLDER_FAULTS,
    FOLDER_LOSSES,
    FOLDER_STRANGERS,
)

NAME = "push-indicator"
ODD = "zzz"
Place = Callable[[str], Registry]


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


def every(folder: object, bucket: object) -> list[object]:
    """Return the parameters of a test: the kinds of both storages."""
    kinds = {"folder": folder, "bucket": bucket}
    return [pytest.param(kind, each, id=f"{kind}: {each!r}") for kind in kinds for each in kinds[kind]]  # type: ignore[attr-defined]


@pytest.fixture
def places(request: pytest.FixtureRequest, kind: str) -> Place:
    """Return the function that opens registries in this kind of storage."""
    found: Place = request.getfixturevalue(f"{kind}_place")
    return found


@pytest.fixture
def two_models(places: Place) -> Registry:
    """A registry with two models. The odd one, which sorts last, gets the fault."""
    found = places("models")
    publish_fake(found)
    publish_fake(found, alias=None)
    publish_fake(found, ODD)
    publish_fake(found, ODD, alias=None)
    return found


@pytest.fixture
def models(two_models: Registry) -> LoadedModels:
    """Return its loaded models."""
    loaded = LoadedModels(two_models, load_fake)
    loaded.refresh()
    assert (loaded.snapshot.problems, len(loaded.snapshot.models)) == ((), 4)
    return loaded


def diagnosis(registry: Registry) -> list[RegistryFinding]:
    """Return the findings of the diagnosis, without those of the gates, which refuse the fakes."""
    return [finding for finding in examine(registry, load_fake) if "gates refuse" not in finding.wrong]


def champion(models: LoadedModels, name: str) -> int:
    """Return the version that answers for a name."""
    return models.snapshot.find(ModelReference.parse(name)).manifest.version


@pytest.mark.parametrize(("kind", "fault"), every(FOLDER_FAULTS, BUCKET_FAULTS))
def test_fault_of_one_model_stays_with_it(
    kind: str, fault: str, two_models: Registry, models: LoadedModels, places: Place
) -> None:
    """A model that cannot be read stays served. The other one is followed, and is served by a new process.

    The fault is named with its model in problems, metrics and the diagnosis, and it does not hide a new change.
    """
    (FOLDER_FAULTS if kind == "folder" else BUCKET_FAULTS)[fault](two_models, ODD)
    models.refresh()
    assert champion(models, ODD) == 1
    two_models.point_alias(NAME, "champion", 2)
    models.refresh()
    assert (champion(models, NAME), champion(models, ODD)) == (2, 1)
    assert models.counters.registry_up
    assert [problem for problem in models.snapshot.problems if problem.startswith(ODD)]
    assert all(problem.isprintable() for problem in models.snapshot.problems)
    assert {name for name, count in models.snapshot.problem_counts.items() if count} == {ODD}
    fresh = LoadedModels(places("models"), load_fake)
    fresh.refresh()
    assert champion(fresh, NAME) == 2
    assert [problem for problem in fresh.snapshot.problems if problem.startswith(ODD)]
    severe = [finding for finding in diagnosis(places("models")) if finding.severe]
    assert severe
    assert all(finding.where.startswith(ODD) for finding in severe)
    assert publish_fake(two_models, "push-none", ContextKind.NONE) == 1
    fresh.refresh()
    assert champion(fresh, "push-none") == 1


@pytest.mark.parametrize(("kind", "shown"), every(FOLDER_STRANGERS, BUCKET_STRANGERS))
def test_entry_in_a_models_place_is_named_and_stops_no_model(
    kind: str, shown: str, two_models: Registry, models: LoadedModels
) -> None:
    """An entry that is no model, in a model's place, is named without a character that a terminal obeys."""
    (FOLDER_STRANGERS if kind == "folder" else BUCKET_STRANGERS)[shown](two_models)
    two_models.point_alias(NAME, "champion", 2)
    models.refresh()
    assert (champion(models, NAME), champion(models, ODD)) == (2, 1)
    (problem,) = models.snapshot.problems
    assert problem.startswith(f"{shown} is ")
    assert models.snapshot.problem_counts[shown] == 1
    (finding,) = diagnosis(two_models)
    assert (finding.where, finding.severe) == (shown, True)


@pytest.mark.parametrize(("kind", "loss"), every(FOLDER_LOSSES, [loss for loss in BUCKET_LOSSES if loss != "versions"]))
def test_absence_without_a_removal_unloads_no_model(
    kind: str, loss: str, two_models: Registry, models: LoadedModels
) -> None:
    """A default model whose content disappears stays served, and the service is ready and names the absence.

    Other changes are followed. The objects of a version are not asked for again while it is loaded.
    """
    harms = FOLDER_LOSSES if kind == "folder" else BUCKET_LOSSES
    harms[loss](two_models, NAME)
    with TestClient(create_app(Settings(poll_interval_s=3600), models)) as client:
        for _ in range(2):
            models.refresh()
            assert (champion(models, NAME), champion(models, ODD)) == (1, 1)
            ready = client.get("/readyz")
            assert ready.status_code == 200
            assert [problem for problem in ready.json()["problems"] if NAME in problem or "listed" in problem]
    if loss not in ("registry", "all models"):
        publish_fake(two_models, ODD)
        models.refresh()
        assert (champion(models, NAME), champion(models, ODD)) == (1, 3)


@pytest.mark.parametrize(
    ("kind", "loss"),
    [("folder", loss) for loss in FOLDER_LOSSES if loss not in ("content of the model", "model")]
    + [("bucket", loss) for loss in BUCKET_LOSSES if loss not in ("state and history", "model")],
)
def test_new_process_is_not_ready_without_a_recorded_default_model(
    kind: str, loss: str, two_models: Registry, places: Place
) -> None:
    """A new process is not ready while a default model that the two_models records does not answer.

    Losses that leave no trace of the model are left out.
    """
    publish_fake(two_models, "push-none", ContextKind.NONE)
    (FOLDER_LOSSES if kind == "folder" else BUCKET_LOSSES)[loss](two_models, NAME)
    fresh = LoadedModels(places("models"), load_fake)
    with TestClient(create_app(Settings(poll_interval_s=3600), fresh)) as client:
        ready = client.get("/readyz")
        assert ready.status_code == 503
        assert ready.json()["reason"].startswith("not ready, looking again every 3600 s, because ")
        assert ready.json()["problems"]


@pytest.mark.parametrize(("kind", "loss"), [("folder", "content of the model"), ("bucket", "state and history")])
def test_a_model_that_lost_its_record_is_named_by_a_new_process(
    kind: str, loss: str, two_models: Registry, places: Place
) -> None:
    """A folder with neither versions nor a history is a problem of its model, also for a process that starts later."""
    (FOLDER_LOSSES if kind == "folder" else BUCKET_LOSSES)[loss](two_models, NAME)
    fresh = LoadedModels(places("models"), load_fake)
    fresh.refresh()
    assert fresh.snapshot.problems == (f"{NAME} has neither a version nor a history",)


@pytest.fixture
def kind(request: pytest.FixtureRequest) -> str:
    """Return the kind of storage, for tests that need no faults of its own."""
    return str(request.param)


@pytest.mark.parametrize("kind", ["folder", "bucket"], indirect=True)
def test_recorded_removal_of_lost_content_is_obeyed(kind: str, two_models: Registry, models: LoadedModels) -> None:
    """An operator can record the end of a version and of an alias that disappeared. Both are unloaded then."""
    losses = FOLDER_LOSSES if kind == "folder" else BUCKET_LOSSES
    publish_fake(two_models, ODD, alias="canary")
    models.refresh()
    losses["versions"](two_models, ODD)
    if kind == "folder":
        FOLDER_LOSSES["aliases"](two_models, ODD)
    two_models.drop_alias(ODD, "champion")
    two_models.remove(ODD, 1, reason="lost")
    models.refresh()
    assert (ODD, "champion") not in models.snapshot.aliases
    assert 1 not in models.snapshot.versions(ODD)
    assert models.snapshot.aliases_of(ODD) == {"canary": 3}


@contextlib.contextmanager
def without_rights() -> Iterator[None]:
    """Act as a user that is not root. Root may read every folder."""
    is_root = os.geteuid() == 0
    if is_root:
        os.seteuid(12345)
    try:
        yield
    finally:
        if is_root:
            os.seteuid(0)


@pytest.mark.parametrize("part", ["", "aliases", "aliases/champion"])
def test_entry_without_rights_is_a_fault_of_its_model(folder_place: Place, tmp_path: Path, part: str) -> None:
    """A folder or a file that the service may not read stops no other model."""
    registry = folder_place("models")
    publish_fake(registry)
    publish_fake(registry, ODD)
    for parent in tmp_path.parents:
        if parent.stat().st_uid == os.getuid() and parent != Path("/"):
            parent.chmod(parent.stat().st_mode | 0o055)
    tmp_path.chmod(0o755)
    models = LoadedModels(registry, load_fake)
    with without_rights():
        models.refresh()
    path = registry.root / ODD / part
    path.chmod(0)
    publish_fake(registry)
    with without_rights():
        models.refresh()
        fresh = LoadedModels(folder_place("models"), load_fake)
        fresh.refresh()
        found = [finding for finding in diagnosis(registry) if finding.severe]
    path.chmod(0o755)
    assert (champion(models, NAME), champion(models, ODD), champion(fresh, NAME)) == (2, 1, 2)
    for each in (models.snapshot, fresh.snapshot):
        assert [problem for problem in each.problems if ODD in problem and "Permission denied" in problem]
    assert [finding for finding in found if ODD in finding.where and "Permission denied" in finding.wrong]


class FailingDisk(FolderStorage):
    """A disk that cannot read one model: it reports an input/output error."""

    def _entries(self, *parts: str) -> list[str]:
        if parts[0] == ODD:
            raise BrokenModelError(f"{ODD}: {os.strerror(errno.EIO)}")
        return super()._entries(*parts)


class Buggy(FolderStorage):
    """A storage with a bug that one model meets."""

    def state(self, name: str) -> ModelState:
        """See ``Storage.state``."""
        if name == ODD:
            raise ZeroDivisionError
        return super().state(name)


@pytest.mark.parametrize(("storage", "cause"), [(FailingDisk, "Input/output error"), (Buggy, "the log has the cause")])
def test_failing_disk_or_bug_of_one_model_stays_with_it(
    folder_place: Place, storage: type[FolderStorage], cause: str
) -> None:
    """An input/output error, and a bug, that one model meets stop no other one."""
    registry = folder_place("models")
    publish_fake(registry)
    publish_fake(registry, ODD)
    models = LoadedModels(Registry(storage(registry.root)), load_fake)
    models.refresh()
    publish_fake(registry)
    models.refresh()
    assert champion(models, NAME) == 2
    assert [problem for problem in models.snapshot.problems if problem.startswith(ODD) and cause in problem]


class Interruption:
    """A profiler that acts once, before the n-th call to a registry's folder or bucket, as another process could.

    ``every`` acts before each call.
    """

    def __init__(self, registry: Registry, act: Callable[[], object], turn: int = 1, *, every: bool = False) -> None:
        self._modules = ("posix", "fcntl") if isinstance(registry.storage, FolderStorage) else ()
        self._act, self._every, self.left = act, every, turn

    def __call__(self, frame: FrameType, event: str, called: object) -> None:
        """Count a call."""
        if event == "c_call" and (called in REQUESTS or getattr(called, "__module__", None) in self._modules):
            self.left -= 1
            if self.left == 0 or self._every:
                with self.paused():
                    self._act()

    @contextlib.contextmanager
    def paused(self) -> Iterator[None]:
        """Stop counting."""
        sys.setprofile(None)
        yield
        sys.setprofile(self)


REQUESTS = (obstore.put, obstore.get, obstore.head, obstore.delete, obstore.list_with_delimiter)


def begin(registry: Registry) -> None:
    """Publish two versions of a model, and name both."""
    publish_fake(registry)
    publish_fake(registry, alias="challenger")


def change(registry: Registry) -> None:
    """Make a change of every kind, and publish the first version of another model."""
    publish_fake(registry, ODD)
    publish_fake(registry, alias="canary")
    registry.drop_alias(NAME, "challenger")
    registry.remove(NAME, 2)
    registry.point_alias(NAME, "champion", 3)


def faults(registry: Registry) -> list[str]:
    """Return what looks like damage: faults of the histories and of their comparison with what is there."""
    found: list[str] = []
    for name in registry.names():
        state, history = registry.record(name)
        lost = history.lost(state)
        found += history.problems
        found += [f"{name} lost {part}" for part in (*lost.versions, *lost.aliases)]
        found += [str(event) for event in unrecorded(history.state(), state)[1:]]  # a writer at work leaves one
    return found


def test_change_between_two_reads_is_no_fault(place: Place) -> None:
    """A registry that changes between any two calls of a reader has no fault."""
    turn, left = 0, 0
    while left <= 0:
        turn += 1
        registry = place(f"models-{turn}")
        begin(registry)
        other = place(f"models-{turn}")
        interruption = Interruption(registry, functools.partial(change, other), turn)
        sys.setprofile(interruption)
        found = faults(registry)
        sys.setprofile(None)
        left = interruption.left
        assert found == [], turn
    assert turn > 10


def test_read_between_two_steps_of_a_writer_finds_no_fault(place: Place) -> None:
    """A registry that is read before every call of a writer has no fault, from its first version on.

    One exception: until its line is written, an alias that is being dropped looks like one that vanished.
    """
    registry, reader = place("models"), place("models")
    found: list[list[str]] = []
    publish_fake(registry, "first")
    sys.setprofile(Interruption(registry, lambda: found.append(faults(reader)), every=True))
    begin(registry)
    change(registry)
    sys.setprofile(None)
    assert len(found) > 50
    assert {fault for each in found for fault in each} <= {f"{NAME} lost challenger"}
