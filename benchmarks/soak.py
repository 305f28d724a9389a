"""Soak test: an hour of load with swaps, SIGTERMs and hostile clients at once.

    python -m benchmarks.soak [--minutes 60] [--load 0.7] [--swap-every-s 10] [--end-every-s 60] [--out FOLDER]

Two instances over one registry run behind nginx. First wrk measures their capacity at full speed. Then it sends
requests at 70 % of that rate for the whole time. Meanwhile versions are published and become the champion, one instance
is ended by SIGTERM and started again, and hostile clients (benchmarks/hostile_clients.py) connect to both instances
directly. The other instance lives the whole time, and its memory has to stay constant. All events are written to
record.jsonl in the folder as they happen. At the end, or after Ctrl-C, a report with a plot is written.
``--only-report`` writes the report of a record again.

The exit status is 1 if a request failed, an instance did not exit with 0, an instance was ready but did not predict, or
memory grew by more than the bound between the first and the last tenth. nginx and wrk come with the distribution.
"""

import argparse
import json
import math
import platform
import shutil
import signal
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Sequence
from concurrent.futures import FIRST_EXCEPTION, Future, ThreadPoolExecutor, wait
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path

from tqdm import tqdm

import service
from benchmarks.cluster import Instance, WrkProcess, count_refused_and_retried, instances, nginx, rss_mib
from benchmarks.hostile_clients import HostileClients
from benchmarks.http_load import ROOT
from benchmarks.soak_report import RECORD_FILE, write_report
from benchmarks.swap import NAME, publish
from benchmarks.version_agreement import Agreement, VersionProbe
from service.processors import processors
from service.registry.registry import Registry

POLL_INTERVAL_S = 2.0
DRAIN_S = 1.0
WATCH_EVERY_S = 0.1
CHECK_EVERY_S = 2.0
SAMPLE_EVERY_S = 5.0
CAPACITY_ROUNDS = 3
CAPACITY_ROUND_S = 5
WARM_UP_SWAPS = 10
"""Versions published before the start, so that memory holds the largest number of versions from the beginning."""
ENDLESS = 1_000_000


class Record:
    """A record of events: a file with a line of JSON per event, written at once."""

    def __init__(self, path: Path) -> None:
        self._file = path.open("w", encoding="utf-8", buffering=1)
        self._began = time.monotonic()
        self._lock = threading.Lock()

    def write(self, kind: str, **fields: object) -> None:
        """Write a line with the time since the beginning."""
        line = json.dumps({"kind": kind, "at_s": round(time.monotonic() - self._began, 2), **fields})
        with self._lock:
            self._file.write(line + "\n")

    def close(self) -> None:
        """Close the file."""
        self._file.close()


class Soak:
    """The soak test. Every task is a method in a thread that ends on the stop event."""

    def __init__(self, options: argparse.Namespace, folder: Path, record: Record) -> None:
        self._options = options
        self._folder = folder
        self._record = record
        self._stop = threading.Event()
        self._failed = 0

    def run(self, port: int, both: Sequence[Instance]) -> None:
        """Run until the time is over or a task fails. The second instance is the one that is restarted."""
        self._port, self._instances = port, both
        self._registry = Registry(self._folder / "models")
        self._hostile = HostileClients([instance.port for instance in both], self._stop)
        self._rate_per_s = self._measure_capacity()
        tasks = [self._ask, self._publish, self._end_and_start, self._watch, self._sample, *self._hostile.tasks()]
        with ThreadPoolExecutor(len(tasks)) as pool:
            running = [pool.submit(task) for task in tasks]
            try:
                self._wait(running)
            finally:
                self._stop.set()
        for task in running:
            task.result()

    def _wait(self, running: list[Future[None]]) -> None:
        """Show the progress until the time is over or a task fails."""
        for _ in (bar := tqdm(range(round(self._options.minutes * 60)), unit="s", desc="soak")):
            done, _ = wait(running, timeout=1.0, return_when=FIRST_EXCEPTION)
            if any(task.exception() for task in done):
                return
            bar.set_postfix_str(f"failed {self._failed}, {rss_mib(self._instances[0].pid):.0f} MiB")

    def _measure_capacity(self) -> float:
        """Measure the capacity, write the first line of the record, and return the rate of requests per second."""
        rounds = [WrkProcess(self._folder, self._port, CAPACITY_ROUND_S).report() for _ in range(CAPACITY_ROUNDS)]
        capacity_per_s = statistics.median(report.requests_per_s for report in rounds)
        rate_per_s = float(self._options.load * capacity_per_s)
        print(f"capacity {capacity_per_s:.0f} requests/s; asking at {self._options.load:.0%} of it: {rate_per_s:.0f}/s")
        numbers = {name: value for name, value in vars(self._options).items() if isinstance(value, float)}
        self._record.write(
            "run",
            **numbers,
            started=time.strftime("%Y-%m-%d %H:%M", time.gmtime()),
            poll_interval_s=POLL_INTERVAL_S,
            capacity_per_s=capacity_per_s,
            rate_per_s=rate_per_s,
            processors=processors(),
            python=platform.python_version(),
            version=service.__version__,
        )
        return rate_per_s

    def _ask(self) -> None:
        """Send the load, slice by slice without a gap."""
        ends_at = time.monotonic() + self._options.minutes * 60
        slice_s = min(60.0, self._options.minutes * 6)  # a tenth of a short run is a row of the report
        while not self._stop.is_set() and (left_s := ends_at - time.monotonic()) > 1.0:
            wrk_run = WrkProcess(self._folder, self._port, math.ceil(min(slice_s, left_s)), self._rate_per_s)
            while wrk_run.running():
                if self._stop.wait(0.01):
                    wrk_run.stop()
                    break
            report = wrk_run.report()
            self._failed += report.failed
            self._record.write("slice", **asdict(report))
        self._stop.wait()

    def _publish(self) -> None:
        """Run a process that publishes, promotes and removes versions."""
        command = [sys.executable, "-m", "benchmarks.swap", "--publish", str(self._registry.root)]
        command += ["--swaps", str(ENDLESS), "--interval", str(self._options.swap_every_s)]
        publisher = subprocess.Popen(command, cwd=ROOT, process_group=0)
        try:
            while not self._stop.wait(0.5):
                if publisher.poll() is not None:
                    raise SystemExit(f"the publisher ended with {publisher.returncode}")
        finally:
            publisher.kill()
            publisher.wait()

    def _end_and_start(self) -> None:
        """End one instance by SIGTERM and start it again, at intervals."""
        restarted = self._instances[1]
        while not self._stop.wait(self._options.end_every_s):
            began = time.monotonic()
            status = restarted.end()
            ended = time.monotonic()
            restarted.start()
            self._record.write("end", status=status, end_s=ended - began, start_s=time.monotonic() - ended)

    def _watch(self) -> None:
        """Record the served versions, and check readiness with predictions."""
        probes = [VersionProbe(instance.port) for instance in self._instances]
        agreement, promoted, checked_at = Agreement(), self._champion(), 0.0
        while not self._stop.wait(WATCH_EVERY_S):
            if (champion := self._champion()) != promoted:
                promoted = champion
                agreement.promote(time.monotonic(), champion, len(probes))
            due = time.monotonic() - checked_at > CHECK_EVERY_S
            ready = [probe.ready() for probe in probes] if due else []
            versions = [probe.version() for probe in probes]
            agreement.observe(time.monotonic(), versions)
            if due:
                checked_at = time.monotonic()
                self._record.write("check", ready=ready, versions=versions, champion=champion)
            if agreement.settled and agreement.reached_s:
                self._record.write("promote", version=champion, **agreement.take_times())

    def _champion(self) -> int:
        return self._registry.aliases(NAME)["champion"]

    def _sample(self) -> None:
        """Record memory, open files and threads of both instances, and the outcomes of the hostile clients."""
        while not self._stop.wait(SAMPLE_EVERY_S):
            self._record.write("sample", instances=[_sample_of(instance.pid) for instance in self._instances])
            self._record.write("hostile", outcomes=dict(self._hostile.outcomes))


def _sample_of(pid: int) -> dict[str, float] | None:
    """Return memory, open files and threads of a process, or None if it does not run."""
    with suppress(OSError):
        process = Path(f"/proc/{pid}")
        threads = len(list((process / "task").iterdir()))
        return {"rss_mib": rss_mib(pid), "files": len(list((process / "fd").iterdir())), "threads": threads}
    return None


def _log_of(both: Sequence[Instance]) -> dict[str, int]:
    """Count the lines of the instances' logs, and the errors among them."""
    lines = [line for instance in both for line in instance.log.read_text().splitlines()]
    return {"errors": sum(map(_is_error, lines)), "log_lines": len(lines)}


def _is_error(line: str) -> bool:
    """True if a line of a log is an error, or is not a line of the service."""
    try:
        return json.loads(line)["level"] not in ("INFO", "WARNING")
    except (ValueError, KeyError, TypeError):
        return True


def soak(options: argparse.Namespace) -> None:
    """Run the soak test. The record stays in the folder even after a failure."""
    record = Record(options.out / RECORD_FILE)
    try:
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            shutil.copytree(ROOT / "models", folder / "models")
            publish(folder / "models", WARM_UP_SWAPS, 0.0)
            settings = {"poll_interval_s": POLL_INTERVAL_S, "drain_s": DRAIN_S}
            with instances(2, folder, folder / "models", **settings) as both, nginx(folder, both) as port:
                Soak(options, folder, record).run(port, both)
            record.write("log", **_log_of(both), sent_twice=count_refused_and_retried(folder)[1])
    finally:
        record.close()


def main() -> None:
    """Measure and report. Fail if the report has losses."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=60.0, help="duration of the load")
    parser.add_argument("--load", type=float, default=0.7, help="share of the measured capacity")
    parser.add_argument("--swap-every-s", type=float, default=10.0, help="time between two versions")
    parser.add_argument("--end-every-s", type=float, default=60.0, help="time between two SIGTERMs")
    parser.add_argument("--growth-bound-mib", type=float, default=16.0, help="largest accepted growth of memory")
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "results" / "soak", metavar="FOLDER")
    parser.add_argument("--only-report", action="store_true", help="write the report of the record in the folder")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # SIGTERM gives a report too
    try:
        if not options.only_report:
            soak(options)
    except KeyboardInterrupt:
        print("interrupted: reporting the record so far", file=sys.stderr)
    finally:
        losses = write_report(options.out)
    print(f"{options.out / 'README.md'} has the table and the plot; {options.out / RECORD_FILE} the record")
    if losses:
        raise SystemExit("\n".join(losses))


if __name__ == "__main__":
    main()
