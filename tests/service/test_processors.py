"""Processors are counted within the quota of a container, by both versions of control groups."""

from pathlib import Path

import pytest

from service.processors import processors


def group(folder: Path, quota: str, version: int) -> None:
    """Make a control group with a quota per 100 ms."""
    folder.mkdir(parents=True, exist_ok=True)
    if version == 2:
        (folder / "cpu.max").write_text(f"{quota} 100000\n")
    else:
        (folder / "cpu.cfs_quota_us").write_text(f"{quota}\n")
        (folder / "cpu.cfs_period_us").write_text("100000\n")


@pytest.fixture
def bound(tmp_path: Path) -> int:
    """Return the number of processors of this process without a control group."""
    return processors(tmp_path / "absent", tmp_path / "absent")


@pytest.mark.parametrize("place", ["", "cpu", "cpu,cpuacct"])
@pytest.mark.parametrize(("quota", "expected"), [("100000", 1), ("10000", 1), ("max", None), ("-1", None), ("?", None)])
def test_processors_follow_the_quota_of_the_container(
    tmp_path: Path, bound: int, place: str, quota: str, expected: int | None
) -> None:
    """A fraction of a processor counts as one, and without a quota the processors of the process count."""
    group(tmp_path / place, quota, version=1 if place else 2)
    assert processors(tmp_path, tmp_path / "absent") == (expected or bound)


@pytest.mark.parametrize(
    ("membership", "place", "version"),
    [
        ("0::/system.slice/cazsl.service", "system.slice/cazsl.service", 2),
        ("0::/system.slice/cazsl.service", "system.slice", 2),
        ("12:pids:/a\n4:cpu,cpuacct:/docker/abc\n0::/", "cpu,cpuacct/docker/abc", 1),
        ("4:cpu:/docker/abc", "cpu/docker", 1),
    ],
)
def test_the_group_of_the_process_and_those_above_it_count(
    tmp_path: Path, membership: str, place: str, version: int
) -> None:
    """The listed group of the process limits it, and so does every group above."""
    (tmp_path / "listed").write_text(membership)
    group(tmp_path / "cgroup" / place, "100000", version)
    assert processors(tmp_path / "cgroup", tmp_path / "listed") == 1


def test_groups_of_others_do_not_count(tmp_path: Path, bound: int) -> None:
    """The quota of a neighbour, of another controller, or outside of the mount limits nothing here."""
    (tmp_path / "listed").write_text("4:memory:/mine\n3:cpu:/../outside\n0::/mine\nnonsense\n")
    group(tmp_path / "cgroup" / "other", "1", version=2)
    group(tmp_path / "cgroup" / "memory" / "mine", "1", version=1)
    group(tmp_path / "outside", "1", version=1)
    assert processors(tmp_path / "cgroup", tmp_path / "listed") == bound


def test_the_lowest_quota_counts(tmp_path: Path, bound: int) -> None:
    """Where two groups have a quota, the lower one limits. No quota gives more processors than there are."""
    (tmp_path / "listed").write_text("0::/a/b\n")
    group(tmp_path / "cgroup" / "a", "100000", version=2)
    group(tmp_path / "cgroup" / "a" / "b", "90000000", version=2)
    assert processors(tmp_path / "cgroup", tmp_path / "listed") == 1
    group(tmp_path / "cgroup" / "a", "90000000", version=2)
    assert processors(tmp_path / "cgroup", tmp_path / "listed") == min(bound, 900)
