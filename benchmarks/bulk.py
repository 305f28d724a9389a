"""Throughput of ``cazsl predict --parquet``, start of processes included, with one job and with several.

    python -m benchmarks.bulk [--rows 1000000] [--jobs 2] [--rounds 3]

Each number of jobs runs once in each round. The ratio is that of the medians. All files must be the same bytes.
"""

import argparse
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from benchmarks.http_load import ROOT
from training.omnipush.published import omnipush_descriptors


def write_pushes(path: Path, rows: int) -> None:
    """Write pushes from all directions at Omnipush's objects, in random order."""
    rng = np.random.default_rng(0)
    bearing_rad = rng.uniform(-np.pi, np.pi, rows)
    objects = np.array(omnipush_descriptors())
    columns = {
        "x_m": 0.08 * np.cos(bearing_rad),
        "y_m": 0.08 * np.sin(bearing_rad),
        "angle_rad": bearing_rad + np.pi,
        "descriptor": objects[rng.integers(len(objects), size=rows)],
    }
    pq.write_table(pa.table(columns), path)


def predict_s(source: Path, target: Path, jobs: int) -> float:
    """Return the duration of the command, in s."""
    command = [sys.executable, "-c", "from service.cli.main import main; main()", "predict"]
    started = time.perf_counter()
    arguments: list[str | Path] = ["--registry", ROOT / "models", "--parquet", source, target, "--jobs", str(jobs)]
    subprocess.run([*command, *arguments], check=True, stdout=subprocess.DEVNULL)
    return time.perf_counter() - started


def main() -> None:
    """Measure and print the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rows", type=int, default=1_000_000)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--rounds", type=int, default=3)
    options = parser.parse_args()
    took_s: dict[int, list[float]] = {1: [], options.jobs: []}
    with tempfile.TemporaryDirectory() as folder:
        source, first = Path(folder) / "pushes.parquet", Path(folder) / "first.parquet"
        write_pushes(source, options.rows)
        for number in range(options.rounds):
            for jobs, found in took_s.items():
                target = first if not first.exists() else Path(folder) / f"{number}-{jobs}.parquet"
                found.append(predict_s(source, target, jobs))
                if target.read_bytes() != first.read_bytes():
                    raise SystemExit(f"{jobs} jobs wrote other bytes than 1")
    medians = {jobs: statistics.median(found) for jobs, found in took_s.items()}
    for jobs, seconds in medians.items():
        print(f"{jobs} job{'s' * (jobs > 1)}: {options.rows / seconds:10,.0f} rows/s, {seconds:.1f} s")
    print(f"{options.jobs} jobs are {medians[1] / medians[options.jobs]:.2f} times as fast as 1; all files are equal")


if __name__ == "__main__":
    main()
