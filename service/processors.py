"""The number of processors that this process may use."""

import math
import os
from pathlib import Path
from typing import Final

_CGROUP_CPU: Final = Path("/sys/fs/cgroup/cpu.max")


def processors(cgroup_cpu: Path = _CGROUP_CPU) -> int:
    """Return the container's quota, or the processors that the process is bound to if they are fewer; at least 1."""
    bound = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    try:
        quota, period = cgroup_cpu.read_text(encoding="ascii").split()
        allowed = math.ceil(int(quota) / int(period))
    except (OSError, ValueError):  # no cgroup, or "max"
        return bound
    return max(1, min(bound, allowed))
