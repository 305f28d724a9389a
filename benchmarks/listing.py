"""Time to list a registry with 1,000 versions of one model, and of one poll of a service.

python -m benchmarks.listing [--versions 1000]

Versions are copied without syncing the disk, because only reading is measured. Prints the median of 20 warm reads.
"""

import argparse
import shutil
import statistics
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from benchmarks.http_load import ROOT
from service.registry.registry import Registry

NAME = "push-indicator"


def median_ms(read: Callable[[], object]) -> float:
    """Return the median duration of 20 reads after a first one, in ms."""
    read()
    found = []
    for _ in range(20):
        started = time.perf_counter()
        read()
        found.append(time.perf_counter() - started)
    return 1000 * statistics.median(found)


def main() -> None:
    """Measure and print the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--versions", type=int, default=1000, help="how many versions")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder) / "models"
        shutil.copytree(ROOT / "models", root)
        registry = Registry(root)
        shipped = registry.versions(NAME)[-1]
        for version in range(shipped + 1, options.versions + 1):
            shutil.copytree(root / NAME / str(shipped), root / NAME / str(version))
        print(f"{len(registry.versions(NAME))} versions of one model, warm")
        print(f"list versions and aliases    {median_ms(lambda: registry.state(NAME)):8.2f} ms")
        print(f"one poll without news        {median_ms(registry.fingerprint):8.2f} ms")


if __name__ == "__main__":
    main()
