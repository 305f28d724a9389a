"""What swapping models costs the requests that run meanwhile.

    python -m benchmarks.swap [--swaps 100] [--rounds 3]

Asks a service with wrk at 4 connections in three phases per round: nothing else going on; a publisher writing versions
into a registry that nobody serves (the price of sharing the machine with it); and the same publisher writing into the
registry that is served, each version becoming the champion at once and being loaded, checked and swapped in. Prints
median and 99th percentile over the rounds, the ratios to the phase before, and fails if any request failed or any swap
was missed. Both cores of a small machine are shared by wrk, service and publisher: read the ratios, not the times.
"""

import argparse
import http.client
import json
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from benchmarks.asking import OURS, PUSH, ROOT, Figures, Load, Server, ask, free_port, server
from service.registry import Registry

NAME = "push-indicator"
PATH = "/v1/predict"
CONNECTIONS = 4
PHASES = ("alone", "publishing elsewhere", "swapping")


def publish(root: Path, swaps: int, interval_s: float) -> None:
    """Publish the first version again and again, each time as the champion; old ones are removed on the way."""
    registry = Registry(root)
    first = registry.read(NAME, 1)
    for _ in range(swaps):
        started = time.monotonic()
        version = registry.publish(first.manifest, first.model, first.card).version
        registry.point_alias(NAME, "champion", version)
        if version > 30:
            registry.remove(NAME, version - 20)
        time.sleep(max(0.0, interval_s - (time.monotonic() - started)))


def served_version(port: int) -> int:
    """Which version answers now."""
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=10)
    connection.request("POST", PATH, PUSH, {"Content-Type": "application/json"})
    return int(json.loads(connection.getresponse().read())["model"]["version"])


def phase(asked: Server, script: Path, target: Path | None, swaps: int, seconds: int) -> Figures:
    """One run of wrk, a publisher beside it unless there is no target."""
    if target is None:
        return ask(asked, script, PATH, CONNECTIONS, seconds)
    interval_s = (seconds - 1) / swaps
    command = [sys.executable, "-m", "benchmarks.swap", "--publish", str(target), "--swaps", str(swaps)]
    publisher = subprocess.Popen([*command, "--interval", str(interval_s)], cwd=ROOT)
    try:
        return ask(asked, script, PATH, CONNECTIONS, seconds)
    finally:
        if publisher.wait(timeout=600):
            raise SystemExit("the publisher failed")


def measure(options: argparse.Namespace, folder: Path) -> None:
    """All rounds over one service."""
    served, elsewhere = folder / "served", folder / "elsewhere"
    for root in (served, elsewhere):
        shutil.copytree(ROOT / "models", root)
    script = Load(PATH, PUSH, {"Content-Type": "application/json"}).script(folder, "push")
    os.environ.update(CAZSL_REGISTRY=str(served), CAZSL_POLL_INTERVAL_S="0.05", CAZSL_LOG_LEVEL="ERROR")
    port, found = free_port(), {name: list[Figures]() for name in PHASES}
    with server([sys.executable, *OURS], port) as asked:
        ask(asked, script, PATH, CONNECTIONS, 2)
        for _ in range(options.rounds):
            for name, target in zip(PHASES, (None, elsewhere, served), strict=True):
                found[name].append(phase(asked, script, target, options.swaps, options.seconds))
        time.sleep(1.0)
        last, published = served_version(port), Registry(served).versions(NAME)[-1]
    print(f"{options.rounds} rounds of {options.seconds} s, {options.swaps} swaps in each, {CONNECTIONS} connections")
    before: tuple[float, float] | None = None
    for name, figures in found.items():
        p50 = statistics.median(figure.p50_us for figure in figures)
        p99 = statistics.median(figure.p99_us for figure in figures)
        ratios = "" if before is None else f"   x{p50 / before[0]:.2f}  x{p99 / before[1]:.2f} of the phase before"
        print(f"{name:<22} p50 {p50 / 1000:6.2f} ms   p99 {p99 / 1000:6.2f} ms{ratios}")
        before = (p50, p99)
    print(f"failed requests: 0; served at the end: version {last} of {published} published")
    if last != published:
        raise SystemExit("a swap was missed")


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--swaps", type=int, default=100, help="swaps per round")
    parser.add_argument("--seconds", type=int, default=20, help="length of one run of wrk")
    parser.add_argument("--rounds", type=int, default=3, help="runs of each phase")
    parser.add_argument("--publish", type=Path, metavar="ROOT", help="only publish into this registry")
    parser.add_argument("--interval", type=float, default=0.2, help="seconds between two versions")
    options = parser.parse_args()
    if options.publish is not None:
        publish(options.publish, options.swaps, options.interval)
        return
    if shutil.which("wrk") is None:
        raise SystemExit("wrk is not installed: apt-get install wrk")
    with tempfile.TemporaryDirectory() as folder:
        measure(options, Path(folder))


if __name__ == "__main__":
    main()
