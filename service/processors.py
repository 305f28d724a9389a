"""The number of processors that this process may use."""

import math
import os
from pathlib import Path
from typing import Final

_CGROUP_CPU: Final = Path("/sys/fs/cgroup/cpu.max")


def processors(cgroup_cpu: Path = _CGROUP_CPU) -> int:
    """Return the quota of the container, or the number of processors that the process is bound to if that is lower."""
    bound = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    try:
        quota, period = cgroup_cpu.read_text(encoding="ascii").split()
        allowed = math.ceil(int(quota) / int(period))
    except (OSError, ValueError):  # no cgroup, or no quota ("max")
        return bound
    return max(1, min(bound, allowed))
