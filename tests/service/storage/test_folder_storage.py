"""Tests of a registry on a real disk: killed processes, full disks, missing permissions, concurrent writers."""

import json
import os
import resource
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from service.errors import BrokenModelError, PublishError, RegistryError
from service.registry.registry import Registry
from service.storage.history import Event, History
from tests.fakes import draft_manifest, publish_fake

NAME = "push-indicator"
PATIENCE_S = 120.0  # bounds a hang and is not a measurement


@pytest.fixture
def registry(tmp_path: Path) -> Registry:
    """A registry with two versions, of which the first is the champion."""
    found = Registry(tmp_path / "models")
    publish_fake(found)
    publish_fake(found, alias=None)
    return found


def python(root: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run Python in a process of its own."""
    return subprocess.run(
        [sys.executable, *arguments],
        cwd=root,
        env={**os.environ, "PYTHONPATH": str(root)},
        capture_output=True,
        text=True,
        check=False,
        timeout=PATIENCE_S,
    )


@pytest.mark.parametrize(
    ("action", "before", "after"),
    [
        ("publish", ("1,2", "1"), ("1,2,3", "1")),
        ("alias", ("1,2", "1"), ("1,2", "2")),
        ("new-alias", ("1,2", "1"), ("1,2", "1")),
        ("drop-alias", ("1,2", "1"), ("1,2", "0")),
        ("remove", ("1,2", "1"), ("1", "1")),
        ("first-publish", ("1,2", "1"), ("1,2", "1")),
    ],
)
def test_a_kill_at_any_system_call_leaves_the_old_state_or_the_new_one(
    registry: Registry, project_root: Path, action: str, before: tuple[str, str], after: tuple[str, str]
) -> None:
    """A writer killed before its n-th system call leaves the old or the new state.

    Every visible byte verifies, no number is used twice, and the next writer completes the history.
    """
    done = python(project_root, "-m", "tests.service.kill_at_every_call", str(registry.root), action)
    assert done.returncode == 0, done.stderr
    rounds = [line.split() for line in done.stdout.splitlines()]
    assert [int(status) for status, *_ in rounds] == [-signal.SIGKILL] * (len(rounds) - 1) + [0]
    seen = [(versions, champion) for _, versions, champion in rounds]
    assert len(seen) > 20
    turn = seen.index(after)
    assert seen == [before] * turn + [after] * (len(seen) - turn), (
        "expected the old state, then the new one, and no third state"
    )
    assert before == after or turn > 0


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of 256 kB. The test is skipped if this machine does not allow the mount."""
    where = tmp_path / "disk"
    where.mkdir()
    mounted = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=256k", "tmpfs", str(where)],  # noqa: S607
        capture_output=True,
        check=False,
    )
    if mounted.returncode:
        pytest.skip("no permission to mount a file system; the tests with a limit on file sizes cover the same code")
    yield where
    subprocess.run(["umount", str(where)], check=True)  # noqa: S607


def test_full_disk_refuses_a_version_and_keeps_the_earlier_ones(small_disk: Path) -> None:
    """The version that fills the disk is refused, all earlier ones verify, and publishing works once space is freed."""
    registry = Registry(small_disk / "models")
    with pytest.raises(PublishError, match="No space left"):
        publish_until_it_fails(registry)
    versions = registry.versions(NAME)
    assert 1 < len(versions) < 20
    assert all(registry.read(NAME, version).model == b"x" * 20_000 for version in versions)
    assert not list((small_disk / "models" / NAME).glob(".staging-*"))
    registry.remove(NAME, 1)
    assert publish_fake(registry, model=b"x" * 10_000, alias=None) == versions[-1] + 1
    assert registry.history(NAME).problems == ()


def test_disk_without_free_space_keeps_the_history_whole(small_disk: Path) -> None:
    """An alias that cannot move for lack of space stays, and no line of the history is torn."""
    registry = Registry(small_disk / "models")
    publish_fake(registry)
    publish_fake(registry, alias=None)
    with pytest.raises(OSError, match="No space"):
        (small_disk / "filler").write_bytes(bytes(1 << 20))
    for _ in range(200):  # until the space left in the history's last page is used up
        try:
            registry.point_alias(NAME, "champion", 2)
            registry.point_alias(NAME, "champion", 1)
        except RegistryError:
            break
    else:
        pytest.fail("the disk did not fill up")
    assert registry.history(NAME).torn_bytes == 0
    assert registry.aliases(NAME)["champion"] in (1, 2)
    (small_disk / "filler").unlink()
    registry.point_alias(NAME, "champion", 2)
    assert registry.unrecorded(NAME) == ()
    assert registry.history(NAME).problems == ()


LIMITED = """
import resource, signal, sys
from pathlib import Path
from service.errors import CazslError
from service.registry.registry import Registry
from tests.fakes import publish_fake
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[2]), resource.RLIM_INFINITY))
try:
    publish_fake(Registry(Path(sys.argv[1])), alias=None)
except CazslError as error:
    print(type(error).__name__, error)
"""


def test_truncated_write_publishes_a_whole_version_or_none(registry: Registry, project_root: Path) -> None:
    """A write that hits a limit on file sizes, from 0 bytes upward, publishes a whole version or none."""
    whole = max(
        (registry.root / NAME / "1" / "manifest.json").stat().st_size,
        (registry.root / NAME / "history.jsonl").stat().st_size + 400,
    )
    outcomes = set()
    for limit in (0, 1, 3, 10, 100, 300, 500, 700, 900, 1100, whole - 300, whole - 1, whole + 1000):
        copy = registry.root.with_name(f"copy-{limit}")
        shutil.copytree(registry.root, copy)
        done = python(project_root, "-c", LIMITED, str(copy), str(limit))
        assert done.returncode == 0, done.stderr
        found = Registry(copy)
        state = found.state(NAME)
        outcomes.add((done.stdout.partition(" ")[0], len(state.versions)))
        assert all(found.read(NAME, version) for version in state.versions)
        assert found.history(NAME).torn_bytes == 0
        assert publish_fake(found, alias=None) == len(state.versions) + 1
        assert found.unrecorded(NAME) == ()
        assert found.history(NAME).problems == ()
    assert {("PublishError", 2), ("", 3)} <= outcomes <= {("PublishError", 2), ("RegistryError", 3), ("", 3)}


AS_ANOTHER_USER = """
import os, sys
from pathlib import Path
from service.errors import CazslError
from service.model.reference import ModelReference
from service.registry.registry import Registry
from tests.fakes import publish_fake
registry = Registry(Path(sys.argv[1]))
registry.read("push-indicator", 1)  # imports the libraries that wait for their first use
if os.getuid() == 0:
    os.setgid(12345), os.setuid(12345)
assert registry.read("push-indicator", registry.resolve(ModelReference.parse("push-indicator"))).model == b"fine"
registry.fingerprint(), registry.history("push-indicator"), registry.unrecorded("push-indicator"), registry.survey()
changes = (
    lambda: publish_fake(registry, alias=None),
    lambda: publish_fake(registry, "push-none", alias=None),
    lambda: registry.point_alias("push-indicator", "champion", 2),
    lambda: registry.remove("push-indicator", 2),
    lambda: registry.sign("push-indicator", 1, b"x"),
)
for change in changes:
    try:
        change()
    except CazslError as error:
        print(type(error).__name__, error)
"""


def test_read_only_registry_is_read_by_another_user_and_stays_unchanged(registry: Registry, project_root: Path) -> None:
    """A user without write permission reads everything, and every change is refused without touching a byte."""
    for path in [registry.root, *registry.root.rglob("*")]:
        path.chmod(0o555 if path.is_dir() else 0o444)
    for path in registry.root.parents:
        if path.stat().st_uid == os.getuid() and path != Path("/"):
            path.chmod(path.stat().st_mode | 0o055)
    before = snapshot(registry.root)
    done = python(project_root, "-c", AS_ANOTHER_USER, str(registry.root))
    for path in [registry.root, *registry.root.rglob("*")]:
        path.chmod(0o755 if path.is_dir() else 0o644)
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("Permission denied") == len(done.stdout.splitlines()) == 5
    assert snapshot(registry.root) == before


def test_read_only_mount_is_read_and_stays_unchanged(small_disk: Path, project_root: Path) -> None:
    """A registry on a read-only mount can be read, and every change is refused, even for root."""
    publish_fake(Registry(small_disk / "models"))
    publish_fake(Registry(small_disk / "models"), alias=None)
    subprocess.run(["mount", "-o", "remount,ro", str(small_disk)], check=True)  # noqa: S607
    registry = Registry(small_disk / "models")
    assert registry.read(NAME, 1).model == b"fine"
    assert registry.history(NAME).problems == ()
    with pytest.raises(PublishError, match="Read-only file system; no version was published"):
        publish_fake(registry, alias=None)
    with pytest.raises(RegistryError, match="Read-only file system; no change was made"):
        registry.point_alias(NAME, "champion", 2)
    assert registry.aliases(NAME) == {"champion": 1}


PUBLISHER = """
import sys
from pathlib import Path
from service.registry.registry import Registry
from tests.fakes import publish_fake
for _ in range(10):
    print(publish_fake(Registry(Path(sys.argv[1])), alias=None))
"""


def test_concurrent_processes_publish_distinct_numbers(tmp_path: Path, project_root: Path) -> None:
    """Three processes that publish ten versions each into a new registry get the numbers 1 to 30, none twice."""
    root = tmp_path / "models"
    running = [
        subprocess.Popen(
            [sys.executable, "-c", PUBLISHER, str(root)], cwd=project_root, stdout=subprocess.PIPE, text=True
        )
        for _ in range(3)
    ]
    numbers = [int(line) for process in running for line in process.communicate(timeout=PATIENCE_S)[0].split()]
    registry = Registry(root)
    assert sorted(numbers) == registry.versions(NAME) == list(range(1, 31))
    history = registry.history(NAME)
    assert (history.problems, [event.to for event in history.events]) == ((), list(range(1, 31)))


def test_fingerprint_costs_one_stat_per_model_and_shows_every_change(registry: Registry) -> None:
    """A fingerprint makes one listing and one stat per model, and changes with every change of the registry."""
    publish_fake(registry, "push-none")
    calls: list[str] = []

    def count(frame: object, event: str, function: object) -> None:
        if event == "c_call" and getattr(function, "__module__", None) == "posix":
            calls.append(function.__name__)  # type: ignore[attr-defined]

    sys.setprofile(count)
    registry.fingerprint()
    sys.setprofile(None)
    assert sorted(set(calls) - {"fspath"}) == ["scandir", "stat"]
    assert (calls.count("scandir"), calls.count("stat")) == (1, 2)

    def long_ago() -> object:
        for name in registry.names():
            os.utime(registry.root / name, ns=(1, 1))
        found = registry.fingerprint()
        assert registry.fingerprint() == found
        return found

    before = long_ago()
    for change in (
        lambda: publish_fake(registry, alias=None),
        lambda: registry.point_alias(NAME, "canary", 2),
        lambda: registry.point_alias(NAME, "canary", 3),
        lambda: registry.sign(NAME, 2, b"signature"),
        lambda: registry.drop_alias(NAME, "canary"),
        lambda: registry.remove(NAME, 2),
    ):
        change()
        assert registry.fingerprint() != before
        assert long_ago() == before


def test_recent_change_is_polled_twice(registry: Registry) -> None:
    """A folder that changed within one tick of the clock has another fingerprint than a moment later."""
    os.utime(registry.root / NAME)
    fresh = registry.fingerprint()
    modified = (registry.root / NAME).stat().st_mtime_ns - 1_000_000_000
    os.utime(registry.root / NAME, ns=(modified, modified))
    assert [settled for *_, settled in fresh] == [False]  # type: ignore[attr-defined]
    assert [settled for *_, settled in registry.fingerprint()] == [True]  # type: ignore[attr-defined]


def test_torn_last_line_is_reported_and_then_repaired(registry: Registry) -> None:
    """A torn last line is reported by readers. The next writer cuts it off and records the repair."""
    path = registry.root / NAME / "history.jsonl"
    whole = path.read_bytes()
    path.write_bytes(whole[:-20])
    assert "torn" in registry.history(NAME).problems[0]
    assert path.read_bytes() == whole[:-20], "reading must not change the file"
    registry.point_alias(NAME, "champion", 2)
    history = registry.history(NAME)
    assert history.problems == ()
    assert [event.what for event in history.events[-3:]] == ["repair", "publish", "alias champion"]
    assert "torn" in (history.events[-3].reason or "")
    assert "recorded afterwards" in (history.events[-2].reason or "")


def test_cut_history_is_reported_and_the_repair_is_recorded(registry: Registry) -> None:
    """Lines that are cut off at the end, and a deleted record of the end, are reported. The next writer records it."""
    folder = registry.root / NAME
    for kept in (-1, 0, None):
        if kept is None:
            (folder / "history.head").unlink()
        else:
            lines = (folder / "history.jsonl").read_bytes().splitlines(keepends=True)
            (folder / "history.jsonl").write_bytes(b"".join(lines[:kept]))
        (problem,) = registry.history(NAME).problems
        assert "cut off" in problem
        registry.sign(NAME, 1, b"signature")
        history = registry.history(NAME)
        assert history.problems == ()
        repairs = [event.reason for event in history.events if event.what == "repair"]
        assert repairs[-1] == problem


def test_deleted_history_is_reported(registry: Registry) -> None:
    """A history that is gone is reported, with and without the record of its end."""
    (registry.root / NAME / "history.jsonl").unlink()
    assert "cut off" in registry.history(NAME).problems[0]
    (registry.root / NAME / "history.head").unlink()
    assert "history.jsonl is missing" in registry.history(NAME).problems[0]


def test_history_of_a_writer_without_heads_stays_valid(registry: Registry) -> None:
    """A history that an older writer began, without numbers and a recorded end, is valid and goes on."""
    folder = registry.root / NAME
    old = Event("publish", None, 1).stamped("ann", History().head).render()
    (folder / "history.jsonl").write_bytes(old)
    (folder / "history.head").unlink()
    assert registry.history(NAME).problems == ()
    registry.point_alias(NAME, "champion", 2)
    assert registry.history(NAME).problems == ()
    assert (folder / "history.head").read_text().startswith("4 ")


def test_alias_deleted_by_hand_is_no_order_and_can_be_dropped(registry: Registry) -> None:
    """An alias whose file was deleted is still asked for by the history. An operator can drop it."""
    (registry.root / NAME / "aliases" / "champion").unlink()
    publish_fake(registry, alias=None)
    assert registry.history(NAME).lost(registry.state(NAME)).aliases == {"champion": 1}
    registry.drop_alias(NAME, "champion", reason="meant")
    assert registry.history(NAME).gave_up("champion")
    assert registry.unrecorded(NAME) == ()


@pytest.mark.parametrize("part", ["notes.txt", "Aliases", "aliases/X", "signatures/9", "removed/x", "removed/2"])
def test_every_entry_outside_of_the_layout_is_named(registry: Registry, part: str) -> None:
    """An entry that does not belong is named by the survey, wherever it lies."""
    registry.sign(NAME, 1, b"signature")
    registry.remove(NAME, 2)
    assert registry.survey() == []
    path = registry.root / NAME / part
    (path / "model.onnx" if path.is_dir() else path).write_bytes(b"")
    assert [finding.where for finding in registry.survey()] == [f"{NAME}/{part}"]


def test_number_of_a_folder_deleted_by_hand_is_not_used_again(registry: Registry) -> None:
    """A number that the history records is not used again after its folder was deleted by hand."""
    shutil.rmtree(registry.root / NAME / "2")
    assert publish_fake(registry, alias=None) == 3
    assert "vanish" in [event.what for event in registry.history(NAME).events]


def test_removed_number_is_not_used_again_without_its_history(registry: Registry) -> None:
    """A removed number is not used again even if the history file is deleted."""
    registry.remove(NAME, 2)
    (registry.root / NAME / "history.jsonl").unlink()
    assert publish_fake(registry, alias=None) == 3


def test_removed_version_keeps_its_manifest(registry: Registry) -> None:
    """A removed version loses its model and its card. Its manifest stays in a folder that no reader lists."""
    registry.remove(NAME, 2, reason="overconfident")
    left = registry.root / NAME / "removed" / "2"
    assert [entry.name for entry in left.iterdir()] == ["manifest.json"]
    assert json.loads((left / "manifest.json").read_bytes())["version"] == 2
    with pytest.raises(BrokenModelError):
        registry.read(NAME, 2)


def test_history_that_cannot_be_locked_refuses_a_version(registry: Registry) -> None:
    """A version is refused if the history file, which is the lock of every writer, cannot be opened."""
    history = registry.root / NAME / "history.jsonl"
    history.unlink()
    history.mkdir()
    with pytest.raises(PublishError, match="no version was published"):
        publish_fake(registry, alias=None)
    assert registry.versions(NAME) == [1, 2]


def test_failing_disk_is_an_error_and_not_an_empty_answer(registry: Registry) -> None:
    """A failing disk, here without free file descriptors, is an error and not a model without aliases."""
    free = os.dup(0)
    os.close(free)
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (free + 1, hard))
    try:
        with pytest.raises(RegistryError, match="Too many open files"):
            registry.aliases(NAME)
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


def test_model_over_the_size_limit_is_not_published(tmp_path: Path) -> None:
    """A model file that is too large to be read back is not published."""
    registry = Registry(tmp_path / "models", max_model_bytes=10)
    with pytest.raises(BrokenModelError, match=r"model\.onnx: 11 bytes; at most 10"):
        registry.publish(draft_manifest(), b"x" * 11, "card")
    assert not registry.root.exists()


def publish_until_it_fails(registry: Registry) -> None:
    """Publish up to a thousand versions of 20 kB."""
    for _ in range(1000):
        publish_fake(registry, model=b"x" * 20_000, alias=None)


def snapshot(root: Path) -> dict[str, tuple[bytes, int]]:
    """Return the bytes and the modification time of every file below a folder."""
    return {str(path): (path.read_bytes(), path.stat().st_mtime_ns) for path in root.rglob("*") if path.is_file()}
