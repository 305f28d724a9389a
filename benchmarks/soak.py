"""Whether an hour of everything at once costs a request: load, swaps, SIGTERMs and hostile clients.

    python -m benchmarks.soak [--minutes 60] [--load 0.7] [--swap-every-s 10] [--end-every-s 60] [--out FOLDER]

Two instances over one registry behind nginx. First wrk measures what they can do at full speed, then it asks at 70 % of
that for the whole time, while versions are published and become the champion, one instance is ended by SIGTERM and
started again, and hostile clients (benchmarks/hostile.py) have both instances for themselves. The other instance lives
the whole time: its memory has to stay flat. Everything that happens is written to record.jsonl in the folder as it
happens, and at the end, or after Ctrl-C, a report with a plot. ``--only-report`` writes the report of a record again.

The exit status is 1 if a request failed, an instance did not end in order or was not ready when it said so, or memory
grew by more than the bound between the first and the last tenth. nginx and wrk come with the distribution.
"""

import argparse
import json
import math
import os
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
from benchmarks.agreement import Agreement, Witness
from benchmarks.asking import ROOT
from benchmarks.cluster import Asking, Instance, instances, nginx, odd_answers, rss_mib
from benchmarks.hostile import HostileClients
from benchmarks.soak_report import RECORD_FILE, write_report
from benchmarks.swap import NAME, publish
from service.registry.registry import Registry

POLL_INTERVAL_S = 2.0
DRAIN_S = 1.0
WATCH_EVERY_S = 0.1
CHECK_EVERY_S = 2.0
SAMPLE_EVERY_S = 5.0
CAPACITY_ROUNDS = 3
CAPACITY_ROUND_S = 5
WARM_UP_SWAPS = 10
"""So many versions are there from the start that memory holds as many as it ever will."""
ENDLESS = 1_000_000


class Record:
    """Lines of JSON, each written as it happens."""

    def __init__(self, path: Path) -> None:
        self._file = path.open("w", encoding="utf-8", buffering=1)
        self._began = time.monotonic()
        self._lock = threading.Lock()

    def write(self, kind: str, **fields: object) -> None:
        """Add a line, with the time since the beginning."""
        line = json.dumps({"kind": kind, "at_s": round(time.monotonic() - self._began, 2), **fields})
        with self._lock:
            self._file.write(line + "\n")

    def close(self) -> None:
        """No more."""
        self._file.close()


class Soak:
    """Everything at once; every method but ``run`` is a thread that ends when told to stop."""

    def __init__(self, given: argparse.Namespace, folder: Path, record: Record) -> None:
        self._given = given
        self._folder = folder
        self._record = record
        self._stop = threading.Event()
        self._failed = 0

    def run(self, port: int, both: Sequence[Instance]) -> None:
        """Until the time is over or something cannot go on; the second instance is the one that is restarted."""
        self._port, self._instances = port, both
        self._registry = Registry(self._folder / "models")
        self._hostile = HostileClients([instance.port for instance in both], self._stop)
        self._rate_per_s = self._measure_capacity()
        tasks = [self._ask, self._publish, self._end_and_start, self._watch, self._sample, *self._hostile.kinds()]
        with ThreadPoolExecutor(len(tasks)) as pool:
            running = [pool.submit(task) for task in tasks]
            try:
                self._wait(running)
            finally:
                self._stop.set()
        for task in running:
            task.result()

    def _wait(self, running: list[Future[None]]) -> None:
        """Show how far it is."""
        for _ in (bar := tqdm(range(round(self._given.minutes * 60)), unit="s", desc="soak")):
            done, _ = wait(running, timeout=1.0, return_when=FIRST_EXCEPTION)
            if any(task.exception() for task in done):
                return
            bar.set_postfix_str(f"failed {self._failed}, {rss_mib(self._instances[0].pid):.0f} MiB")

    def _measure_capacity(self) -> float:
        """The rate to ask at; it begins the record."""
        rounds = [Asking(self._folder, self._port, CAPACITY_ROUND_S).seen() for _ in range(CAPACITY_ROUNDS)]
        capacity_per_s = statistics.median(seen.requests_per_s for seen in rounds)
        rate_per_s = float(self._given.load * capacity_per_s)
        print(f"capacity {capacity_per_s:.0f} requests/s; asking at {self._given.load:.0%} of it: {rate_per_s:.0f}/s")
        options = {name: value for name, value in vars(self._given).items() if isinstance(value, float)}
        self._record.write(
            "run",
            **options,
            started=time.strftime("%Y-%m-%d %H:%M", time.gmtime()),
            poll_interval_s=POLL_INTERVAL_S,
            capacity_per_s=capacity_per_s,
            rate_per_s=rate_per_s,
            processors=os.cpu_count(),
            python=platform.python_version(),
            version=service.__version__,
        )
        return rate_per_s

    def _ask(self) -> None:
        """The load, slice by slice without a gap."""
        ends_at = time.monotonic() + self._given.minutes * 60
        slice_s = min(60.0, self._given.minutes * 6)  # a tenth of a short run, which is a row of the report
        while not self._stop.is_set() and (left_s := ends_at - time.monotonic()) > 1.0:
            asking = Asking(self._folder, self._port, math.ceil(min(slice_s, left_s)), self._rate_per_s)
            while asking.running():
                if self._stop.wait(0.01):
                    asking.stop()
                    break
            seen = asking.seen()
            self._failed += seen.failed
            self._record.write("slice", **asdict(seen))
        self._stop.wait()

    def _publish(self) -> None:
        """A process that publishes, promotes and removes."""
        command = [sys.executable, "-m", "benchmarks.swap", "--publish", str(self._registry.root)]
        command += ["--swaps", str(ENDLESS), "--interval", str(self._given.swap_every_s)]
        publisher = subprocess.Popen(command, cwd=ROOT, process_group=0)
        try:
            while not self._stop.wait(0.5):
                if publisher.poll() is not None:
                    raise SystemExit(f"the publisher ended with {publisher.returncode}")
        finally:
            publisher.kill()
            publisher.wait()

    def _end_and_start(self) -> None:
        """SIGTERM for one instance, and it comes back."""
        restarted = self._instances[1]
        while not self._stop.wait(self._given.end_every_s):
            began = time.monotonic()
            status = restarted.end()
            ended = time.monotonic()
            restarted.start()
            self._record.write("end", status=status, end_s=ended - began, start_s=time.monotonic() - ended)

    def _watch(self) -> None:
        """Which versions are served, and whether readiness tells the truth."""
        witnesses = [Witness(instance.port) for instance in self._instances]
        agreement, promoted, checked_at = Agreement(), self._champion(), 0.0
        while not self._stop.wait(WATCH_EVERY_S):
            if (champion := self._champion()) != promoted:
                promoted = champion
                agreement.promote(time.monotonic(), champion, len(witnesses))
            due = time.monotonic() - checked_at > CHECK_EVERY_S
            ready = [witness.ready() for witness in witnesses] if due else []
            versions = [witness.version() for witness in witnesses]
            agreement.see(time.monotonic(), versions)
            if due:
                checked_at = time.monotonic()
                self._record.write("check", ready=ready, versions=versions, champion=champion)
            if agreement.settled and agreement.reached_s:
                self._record.write("promote", version=champion, **agreement.take())

    def _champion(self) -> int:
        return self._registry.aliases(NAME)["champion"]

    def _sample(self) -> None:
        """Memory, open files and threads of both instances, and what the hostile clients got until now."""
        while not self._stop.wait(SAMPLE_EVERY_S):
            self._record.write("sample", instances=[_sample_of(instance.pid) for instance in self._instances])
            self._record.write("hostile", outcomes=dict(self._hostile.outcomes))


def _sample_of(pid: int) -> dict[str, float] | None:
    """Of one process; None while there is none."""
    with suppress(OSError):
        process = Path(f"/proc/{pid}")
        threads = len(list((process / "task").iterdir()))
        return {"rss_mib": rss_mib(pid), "files": len(list((process / "fd").iterdir())), "threads": threads}
    return None


def _log_of(both: Sequence[Instance]) -> dict[str, int]:
    """How much the instances had to say, and how much of it is an error."""
    lines = [line for instance in both for line in instance.log.read_text().splitlines()]
    return {"errors": sum(map(_is_error, lines)), "log_lines": len(lines)}


def _is_error(line: str) -> bool:
    """Whether a line of a log is an error, or nothing that the service would write."""
    try:
        return json.loads(line)["level"] not in ("INFO", "WARNING")
    except (ValueError, KeyError, TypeError):
        return True


def soak(given: argparse.Namespace) -> None:
    """Run, and leave the record in the folder whatever happens."""
    record = Record(given.out / RECORD_FILE)
    try:
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            shutil.copytree(ROOT / "models", folder / "models")
            publish(folder / "models", WARM_UP_SWAPS, 0.0)
            settings = {"poll_interval_s": POLL_INTERVAL_S, "drain_s": DRAIN_S}
            with instances(2, folder, folder / "models", **settings) as both, nginx(folder, both) as port:
                Soak(given, folder, record).run(port, both)
            record.write("log", **_log_of(both), sent_twice=odd_answers(folder)[1])
    finally:
        record.close()


def main() -> None:
    """Measure, report, and fail if anything was lost."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=60.0, help="how long")
    parser.add_argument("--load", type=float, default=0.7, help="of the measured capacity")
    parser.add_argument("--swap-every-s", type=float, default=10.0, help="between two versions")
    parser.add_argument("--end-every-s", type=float, default=60.0, help="between two SIGTERMs")
    parser.add_argument("--growth-bound-mib", type=float, default=16.0, help="how much memory may grow")
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "results" / "soak", metavar="FOLDER")
    parser.add_argument("--only-report", action="store_true", help="of the record that is in the folder")
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # whoever ends it gets a report too
    try:
        if not given.only_report:
            soak(given)
    except KeyboardInterrupt:
        print("interrupted: reporting what there is", file=sys.stderr)
    finally:
        losses = write_report(given.out)
    print(f"{given.out / 'README.md'} has the table and the plot; {given.out / RECORD_FILE} everything that was seen")
    if losses:
        raise SystemExit("\n".join(losses))


if __name__ == "__main__":
    main()
