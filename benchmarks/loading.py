"""Time and memory of reading a whole dataset, beside numpy alone on the same files.

    python -m benchmarks.loading [--data data/simulated/abs] [--rounds 7]

Each reading runs in its own process, so peak memory is measured per reading. The peak is that of the whole process,
Python and numpy included. The readings take turns, and the first round warms the system's file cache.
"""

import argparse
import json
import statistics
import subprocess
import sys
from pathlib import Path

READINGS = {
    "numpy": "arrays = [np.load(path) for path in sorted(folder.glob('*_3_not_norm.npy'))]",
    "read_folder": "pushes = read_folder(folder)",
    "... and views": "views = read_views(folder.parent / VIEWS_FOLDER, read_folder(folder).descriptors)",
    "data check": "inspect(folder, quiet=True)",
}
CHILD = """
import json, resource, sys, time
from pathlib import Path
import numpy as np
from training.omnipush.pushes import read_folder
from training.inspection.inspection import inspect
from training.omnipush.views import VIEWS_FOLDER, read_views
folder = Path(sys.argv[1])
started = time.perf_counter()
{reading}
seconds = time.perf_counter() - started
print(json.dumps([seconds, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024]))
"""


def main() -> None:
    """Measure and print the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=Path("data/simulated/abs"), help="a folder of pushes")
    parser.add_argument("--rounds", type=int, default=7, help="readings of each kind")
    options = parser.parse_args()
    found: dict[str, list[tuple[float, float]]] = {name: [] for name in READINGS}
    for number in range(options.rounds + 1):
        for name, reading in READINGS.items():
            command = [sys.executable, "-c", CHILD.format(reading=reading), str(options.data)]
            seconds, peak_mib = json.loads(subprocess.run(command, capture_output=True, check=True).stdout)
            if number:  # the first round fills the cache
                found[name].append((seconds, peak_mib))
    floor = statistics.median(seconds for seconds, _ in found["numpy"])
    print(f"{len(list(options.data.glob('*.npy')))} files of {options.data}, {options.rounds} rounds")
    print("| reading | median (s) | slowest (s) | of numpy | peak memory (MiB) |")
    print("|---|---|---|---|---|")
    for name, rounds in found.items():
        times = [seconds for seconds, _ in rounds]
        median, peak = statistics.median(times), max(mib for _, mib in rounds)
        print(f"| {name} | {median:.3f} | {max(times):.3f} | {median / floor:.1f} | {peak:.0f} |")


if __name__ == "__main__":
    main()
