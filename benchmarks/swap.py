"""Swaps of models: their cost for the requests that run meanwhile.

    python -m benchmarks.swap [--swaps 100] [--rounds 5] [--every-s 1]

The first table has the cost of loading one version by itself: processor time, and the longest time that another thread
waits for the interpreter's lock. Then wrk sends requests to a service over 4 connections. Each round has three phases,
whose order rotates: no swaps; an alias that moves in a registry that is not served (the cost of sharing the machine
with the process that moves it); and the same alias moving in the served registry. All versions are published before. A
move names a version that is not among the newest, so the service has to load it, check it, swap it in and release the
one before.

Percentiles are wrk's. It counts the requests that it would have sent while it waited, so the 99th percentile is about
the hundredth of the time in which answers were slowest. Noise is the ratio between the phases without swaps. On a small
machine wrk, service and mover share the cores, so read the ratios, not the times. The benchmark fails if a request
failed, a swap was missed, or a move named a version that was loaded already (the service counts swaps and loads).
"""

import argparse
import http.client
import json
import math
import os
import re
import shutil
import statistics
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from tqdm import tqdm

from benchmarks.http_load import OURS, PUSH, ROOT, Load, Server, free_port, run_wrk, server
from service.cli.serve import SWITCH_INTERVAL_S
from service.model.predictor import OnnxPredictor
from service.registry.loading import load_version
from service.registry.registry import Registry

NAME = "push-indicator"
PATH = "/v1/predict"
CONNECTIONS = 4
NEWEST_VERSIONS = 2
LOADS = 100
LOWEST_PRIORITY = 19  # the process that moves an alias must not disturb the measurement
QUIET, ELSEWHERE, SWAPPING = "no swaps", "an alias moves elsewhere", "swapping"
MALLOC = {"MALLOC_MMAP_THRESHOLD_": "131072", "MALLOC_TRIM_THRESHOLD_": "4194304"}  # as the image has it
HISTOGRAM = """
local report = done
done = function(summary, latency, requests)
  report(summary, latency, requests)
  local file = io.open("{path}", "w")
  for place = 1, #latency do file:write(string.format("%d %d\\n", latency(place))) end
  file:close()
end
"""


@dataclass(frozen=True)
class Latencies:
    """A histogram of latencies: number of answers by microseconds."""

    counts: Counter[int]

    def percentile_us(self, share: float) -> int:
        """Return the latency that this share of the answers did not exceed, in us."""
        left = share * self.counts.total()
        for took_us, count in sorted(self.counts.items()):
            left -= count
            if left <= 0:
                return took_us
        raise SystemExit("wrk measured no latencies")

    def slower(self, than_us: float) -> int:
        """Return the number of answers that took longer."""
        return sum(count for took_us, count in self.counts.items() if took_us > than_us)


def publish(root: Path, swaps: int, interval_s: float) -> None:
    """Publish the first version again and again, each time as the champion. Old versions are removed on the way."""
    registry = Registry(root)
    first = registry.read(NAME, 1)
    for _ in range(swaps):
        started = time.monotonic()
        version = registry.publish(first.manifest, first.model, first.card).version
        registry.point_alias(NAME, "champion", version)
        if version > 30:
            registry.remove(NAME, version - 20)
        time.sleep(max(0.0, interval_s - (time.monotonic() - started)))


def move(root: Path, swaps: int, every_s: float) -> None:
    """Move the champion to the next version, again and again, at the lowest priority."""
    os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), LOWEST_PRIORITY)  # of this thread alone
    registry = Registry(root)
    champion = registry.aliases(NAME)["champion"]
    for version in range(champion + 1, champion + 1 + swaps):
        time.sleep(every_s)
        registry.point_alias(NAME, "champion", version)


def prepare(root: Path, swaps: int) -> None:
    """Copy the shipped registry and publish a version for every swap, and some that are newer."""
    shutil.copytree(ROOT / "models", root)
    registry = Registry(root)
    first = registry.read(NAME, registry.aliases(NAME)["champion"])
    for _ in tqdm(range(swaps + NEWEST_VERSIONS), desc=f"versions {root.name}", disable=None):
        registry.publish(first.manifest, first.model, first.card)


def longest_wait_ms(work: Callable[[], object]) -> float:
    """Return the longest time that another thread waits for the interpreter's lock during the work, in ms."""
    done, waits = threading.Event(), [0.0]

    def watch() -> None:
        """Read the clock in a loop."""
        last = time.perf_counter()
        while not done.is_set():
            now = time.perf_counter()
            waits.append(now - last)
            last = now

    watcher = threading.Thread(target=watch)
    watcher.start()
    work()
    done.set()
    watcher.join()
    return max(waits) * 1e3


def measure_loads() -> None:
    """Print the cost of one load by itself, for every model that ships."""
    registry = Registry(ROOT / "models")
    sys.setswitchinterval(SWITCH_INTERVAL_S)
    print(f"A load, medians of {LOADS}:\n\n| version | processor (ms) | longest wait of another thread (ms) |")
    print("|---|---|---|")
    for name in registry.names():
        version = registry.versions(name)[-1]
        used, waits = [], []
        for _ in range(LOADS):
            began = time.process_time()
            load_version(registry, OnnxPredictor, name, version)
            used.append((time.process_time() - began) * 1e3)
            waits.append(longest_wait_ms(lambda: load_version(registry, OnnxPredictor, name, version)))  # noqa: B023
        print(f"| {name} {version} | {statistics.median(used):.2f} | {statistics.median(waits):.2f} |")


def served_version(port: int) -> int:
    """Return the version that answers now."""
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=10)
    connection.request("POST", PATH, PUSH, {"Content-Type": "application/json"})
    return int(json.loads(connection.getresponse().read())["model"]["version"])


def counters(port: int) -> dict[str, int]:
    """Return the swaps and loads of the model that the service has counted since it started."""
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=10)
    connection.request("GET", "/metrics")
    text = connection.getresponse().read().decode()
    return {
        event: sum(int(float(value)) for value in re.findall(rf'^{counter}{{.*model="{NAME}".*}} (\S+)$', text, re.M))
        for event, counter in (("swaps", "cazsl_alias_swaps_total"), ("loads", "cazsl_model_loads_total"))
    }


def phase(server_process: Server, script: Path, target: Path | None, swaps: int, every_s: float) -> Latencies:
    """Run wrk once. With a target, an alias moves in that registry meanwhile."""
    seconds = math.ceil((swaps + 1) * every_s)
    with ThreadPoolExecutor(1) as mover:
        moved = mover.submit(move, target, swaps, every_s) if target is not None else None
        run_wrk(server_process, script, PATH, CONNECTIONS, seconds)
        if moved is not None:
            moved.result()
    lines = script.with_suffix(".latencies").read_text().splitlines()
    return Latencies(Counter({int(took_us): int(count) for took_us, count in (line.split() for line in lines)}))


def measure(options: argparse.Namespace, folder: Path) -> dict[str, list[Latencies]]:
    """Run all rounds over one service."""
    targets = {QUIET: None, ELSEWHERE: folder / "elsewhere", SWAPPING: folder / "served"}
    swaps = options.swaps // options.rounds
    for root in filter(None, targets.values()):
        prepare(root, swaps * options.rounds)
    script = Load(PATH, PUSH, {"Content-Type": "application/json"}).script(folder, "push")
    script.write_text(script.read_text() + HISTOGRAM.format(path=script.with_suffix(".latencies")))
    os.environ.update(
        CAZSL_REGISTRY=str(targets[SWAPPING]),
        CAZSL_POLL_INTERVAL_S="0.05",
        CAZSL_LOG_LEVEL="ERROR",
        CAZSL_NEWEST_VERSIONS=str(NEWEST_VERSIONS),
        **MALLOC,
    )
    found: dict[str, list[Latencies]] = {name: [] for name in targets}
    phases = list(targets.items())
    with server([sys.executable, *OURS], free_port()) as server_process:
        run_wrk(server_process, script, PATH, CONNECTIONS, 2)
        before, held_mib = counters(server_process.port), server_process.rss_mib()
        for number in tqdm(range(options.rounds), desc="rounds", disable=None):
            for name, target in phases[number % 3 :] + phases[: number % 3]:
                found[name].append(phase(server_process, script, target, swaps, options.every_s))
        time.sleep(1.0)
        served, champion = served_version(server_process.port), Registry(folder / "served").aliases(NAME)["champion"]
        after, holds_mib = counters(server_process.port), server_process.rss_mib()
    done = {event: after[event] - before[event] for event in before}
    print(f"\n{options.rounds} rounds of {swaps} swaps, one every {options.every_s:g} s; failed requests: 0; ", end="")
    print(f"the service counted {done['swaps']} swaps and {done['loads']} loads; ", end="")
    print(f"served at the end: version {served}, the champion: {champion}; ", end="")
    print(f"memory before {held_mib:.1f} MiB, after {holds_mib:.1f}\n")
    if served != champion or set(done.values()) != {swaps * options.rounds}:
        raise SystemExit("a swap was missed, or named a version that was loaded already")
    return found


def spread(values: list[float]) -> str:
    """Return the text of median and range."""
    return f"{statistics.median(values):.2f} ({min(values):.2f} to {max(values):.2f})"


def report(found: dict[str, list[Latencies]], swaps: int) -> None:
    """Print medians over the rounds of this many swaps, and ratios within a round."""
    p99s = {name: [run.percentile_us(0.99) / 1e3 for run in runs] for name, runs in found.items()}
    print("| phase | p50 (ms) | p99 (ms) | p99.9 (ms) | p99 of the same round without swaps | slower than that p99 |")
    print("|---|---|---|---|---|---|")
    slower: dict[str, list[int]] = {}
    for name, runs in found.items():
        p50, p999 = (spread([run.percentile_us(share) / 1e3 for run in runs]) for share in (0.5, 0.999))
        ratio = spread([mine / quiet for mine, quiet in zip(p99s[name], p99s[QUIET], strict=True)])
        slower[name] = [run.slower(quiet * 1e3) for run, quiet in zip(runs, p99s[QUIET], strict=True)]
        share = sum(slower[name]) / sum(run.counts.total() for run in runs)
        print(f"| {name} | {p50} | {spread(p99s[name])} | {p999} | {ratio} | {share:.2%} |")
    ratios = [mine / other for mine, other in zip(p99s[SWAPPING], p99s[ELSEWHERE], strict=True)]
    more = [(mine - other) / swaps for mine, other in zip(slower[SWAPPING], slower[ELSEWHERE], strict=True)]
    noise = max(p99s[QUIET]) / min(p99s[QUIET])
    print(f"\np99 while swapping, of that while an alias moves elsewhere: {spread(ratios)}")
    print(f"noise: the p99s of the phases without swaps differ by up to a factor of {noise:.2f}")
    print(f"answers slower than the quiet p99, more a swap than a move elsewhere: {spread(more)}")


def main() -> None:
    """Measure and print the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--swaps", type=int, default=100, help="swaps in all")
    parser.add_argument("--rounds", type=int, default=5, help="how many rounds share them")
    parser.add_argument("--every-s", type=float, default=1.0, help="seconds from one swap to the next")
    parser.add_argument("--publish", type=Path, metavar="ROOT", help="only publish into this registry")
    parser.add_argument("--interval", type=float, default=0.2, help="with --publish: seconds between two versions")
    options = parser.parse_args()
    if options.publish is not None:
        publish(options.publish, options.swaps, options.interval)
        return
    if shutil.which("wrk") is None:
        raise SystemExit("wrk is not installed: apt-get install wrk")
    measure_loads()
    with tempfile.TemporaryDirectory() as folder:
        report(measure(options, Path(folder)), options.swaps // options.rounds)


if __name__ == "__main__":
    main()
