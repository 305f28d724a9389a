"""Time and memory of reading and checking a table of pushes, as CSV and as Parquet.

    python -m benchmarks.table_loading [--pushes 1000000] [--objects 4000] [--rounds 5]

The table is made by the program: random numbers in all columns, regular polygons of 4 to 40 corners. Each reading runs
in its own process, so peak memory is measured per reading. The peak is that of the whole process, Python and libraries
included. The readings take turns, and the first round warms the system's file cache.
"""

import argparse
import json
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from service.pushing.outlines import Outline
from training.tables.push_table import PushTable, TableObject
from training.tables.writing import write_table

READINGS = {
    "import alone": "pass",
    "read_table, CSV": "table = read_table(folder / 'csv')",
    "read_table, Parquet": "table = read_table(folder / 'parquet')",
    "read and data check, Parquet": "inspect_table(folder, read_table(folder / 'parquet'), quiet=True)",
}
CHILD = """
import json, sys, time
from pathlib import Path
from training.inspection.tables.inspection import inspect_table
from training.tables.reading import read_table
folder = Path(sys.argv[1])
started, cpu_started = time.perf_counter(), time.process_time()
{reading}
seconds, cpu_seconds = time.perf_counter() - started, time.process_time() - cpu_started
status = Path("/proc/self/status").read_text()  # unlike getrusage, without the process that started this one
peak_kib = next(int(line.split()[1]) for line in status.splitlines() if line.startswith("VmHWM"))
print(json.dumps([seconds, cpu_seconds, peak_kib / 1024]))
"""


def random_table(pushes: int, objects: int) -> PushTable:
    """Return a table of random numbers."""
    rng = np.random.default_rng(0)
    corners = rng.integers(4, 41, objects).tolist()
    polygons = [np.arange(count) * (2.0 * np.pi / count) for count in corners]
    items = tuple(
        TableObject(f"shape-{number:05d}", Outline.of(0.05 * np.column_stack([np.cos(turn), np.sin(turn)])))
        for number, turn in enumerate(polygons)
    )
    turn = rng.uniform(-np.pi, np.pi, pushes)
    pushers = np.column_stack([0.06 * np.cos(turn), 0.06 * np.sin(turn), -turn, rng.uniform(0.01, 0.1, pushes)])
    return PushTable(
        objects=items,
        object_index=np.sort(rng.integers(0, objects, pushes)),
        pushers=pushers,
        outcomes=rng.normal(0.0, 0.02, (pushes, 3)),
        pusher_radius_m=np.full(pushes, 0.005),
        surfaces=("abs", "plywood"),
        surface_index=rng.integers(0, 2, pushes),
        source="random numbers",
        digest="",
    )


def main() -> None:
    """Measure and print the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pushes", type=int, default=1_000_000)
    parser.add_argument("--objects", type=int, default=4000)
    parser.add_argument("--rounds", type=int, default=5, help="readings of each kind")
    options = parser.parse_args()
    found: dict[str, list[tuple[float, ...]]] = {name: [] for name in READINGS}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        table = random_table(options.pushes, options.objects)
        csv, _ = write_table(folder / "csv", table, "csv")
        parquet, _ = write_table(folder / "parquet", table, "parquet")
        sizes = [path.stat().st_size >> 20 for path in (csv, parquet)]
        print(f"{options.pushes} pushes of {options.objects} objects: CSV {sizes[0]} MiB, Parquet {sizes[1]} MiB")
        for number in range(options.rounds + 1):
            for reading, code in READINGS.items():
                command = [sys.executable, "-c", CHILD.format(reading=code), name]
                measured = json.loads(subprocess.run(command, capture_output=True, check=True).stdout)
                if number:  # the first round fills the cache
                    found[reading].append(tuple(measured))
    print("| reading | median (s) | slowest (s) | processor (s) | peak memory (MiB) |")
    print("|---|---|---|---|---|")
    for reading, rounds in found.items():
        seconds, cpu_seconds, peaks = zip(*rounds, strict=True)
        times = f"{statistics.median(seconds):.2f} | {max(seconds):.2f} | {statistics.median(cpu_seconds):.2f}"
        print(f"| {reading} | {times} | {max(peaks):.0f} |")


if __name__ == "__main__":
    main()
