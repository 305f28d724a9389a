"""The number of processors that this process may use."""

import math
import os
from collections.abc import Iterator
from pathlib import Path, PurePosixPath
from typing import Final

_CGROUPS: Final = Path("/sys/fs/cgroup")
_MEMBERSHIP: Final = Path("/proc/self/cgroup")


def processors(cgroups: Path = _CGROUPS, membership: Path = _MEMBERSHIP) -> int:
    """Return the quota of the container, or the number of processors that the process is bound to if that is lower.

    Args:
        cgroups: folder where the control groups are mounted, in version 2, version 1 or both.
        membership: file that lists the groups of this process.
    """
    bound = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    quotas = [quota for group in _groups(cgroups, membership) for quota in _quotas(group)]
    return max(1, min([bound, *quotas]))


def _groups(cgroups: Path, membership: Path) -> Iterator[Path]:
    """Yield the folders of the groups that limit this process: its own, and every group above it.

    In a container the mount often begins with the group of the container, so the listed path is not below it.
    """
    try:
        lines = membership.read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        lines = []
    yield from (cgroups, cgroups / "cpu", cgroups / "cpu,cpuacct")
    for line in lines:
        _, _, rest = line.partition(":")
        controllers, _, path = rest.partition(":")
        if controllers and "cpu" not in controllers.split(","):
            continue
        parts = PurePosixPath(path).parts[1:]
        if ".." not in parts:
            mount = cgroups / controllers if controllers else cgroups
            yield from (mount.joinpath(*parts[:depth]) for depth in range(1, len(parts) + 1))


def _quotas(group: Path) -> Iterator[int]:
    """Yield the quota of a group in whole processors, if it has one, in version 2 or in version 1."""
    for read in (_quota_2, _quota_1):
        try:
            quota, period = read(group)
        except (OSError, ValueError):  # no such file, or "max"
            continue
        if quota > 0 and period > 0:  # version 1 writes -1 for no quota
            yield math.ceil(quota / period)


def _quota_2(group: Path) -> tuple[int, int]:
    quota, period = (group / "cpu.max").read_text(encoding="ascii").split()
    return int(quota), int(period)


def _quota_1(group: Path) -> tuple[int, int]:
    quota, period = ((group / name).read_text(encoding="ascii") for name in ("cpu.cfs_quota_us", "cpu.cfs_period_us"))
    return int(quota), int(period)
