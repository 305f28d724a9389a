"""Replicas: throughput of a second instance, time that two disagree, and requests lost by `kill -9` of one.

    python -m benchmarks.replicas [--rounds 5] [--seconds 3] [--promotes 20] [--kills 20]

Two instances over one registry run behind nginx, under load by wrk.

- Throughput: one instance behind nginx and both, in turn, round by round, with one push per request and with a
  thousand. wrk and nginx share the processors with the instances. On two processors and with one push per request they
  use as much as an instance, so no processor is left for a second one.
- Promotions: a version is published and becomes the champion at once, at a random moment between the instances' polls.
  Each instance is asked a hundred times a second until it answers with that version.
- Kills: one instance after the other is killed under load and started again. While it is away its port must not answer,
  and once it is ready it must predict.

The benchmark fails if a request failed or readiness was wrong. nginx and wrk come with the distribution.
"""

import argparse
import random
import shutil
import statistics
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from tqdm import tqdm

from benchmarks.cluster import ONE_PUSH, Instance, WrkProcess, count_refused_and_retried, instances, nginx
from benchmarks.http_load import ROOT
from benchmarks.serving import ROWS, batch_loads
from benchmarks.swap import NAME, publish
from benchmarks.version_agreement import Agreement, VersionProbe
from service.processors import processors
from service.registry.registry import Registry

A_DAY_S = 24 * 3600
POLL_INTERVAL_S = 2.0
ASK_EVERY_S = 0.01
TIMEOUT_S = 60.0


def throughput(folder: Path, both: Sequence[Instance], rounds: int, seconds: int) -> None:
    """Measure one instance and both, in turn."""
    loads = {"1": ONE_PUSH, f"{ROWS:,}": batch_loads()["JSON"]}
    found: dict[str, list[tuple[float, float]]] = {pushes: [] for pushes in loads}
    with nginx(folder / "one", both[:1]) as one, nginx(folder / "two", both) as two:
        for _ in tqdm(range(rounds), desc="throughput", unit="round"):
            for pushes, load in loads.items():
                alone, together = (
                    _requests_per_s(WrkProcess(folder, port, seconds, None, load)) for port in (one, two)
                )
                found[pushes].append((alone, together))
    print(f"\n## Throughput, {rounds} rounds of {seconds} s each, {processors()} processors\n")
    print("| pushes a request | one instance (requests/s) | two | two to one, median (range) |\n|---|---|---|---|")
    for pushes, rates in found.items():
        ratios = [together / alone for alone, together in rates]
        first, second = (statistics.median(side) for side in zip(*rates, strict=True))
        span = f"{min(ratios):.2f} to {max(ratios):.2f}"
        print(f"| {pushes} | {first:.0f} | {second:.0f} | {statistics.median(ratios):.2f} ({span}) |")


def _requests_per_s(wrk_run: WrkProcess) -> float:
    """Return the requests per second of a run.

    Raises:
        SystemExit: a request failed.
    """
    report = wrk_run.report()
    if report.failed:
        raise SystemExit(f"{report.failed} requests failed")
    return report.requests_per_s


def promotes(root: Path, both: Sequence[Instance], count: int) -> None:
    """Measure the time until each instance serves a promoted version, and the time that they disagree."""
    registry, agreement, chance = Registry(root), Agreement(), random.Random(0)  # noqa: S311
    probes = [VersionProbe(instance.port) for instance in both]
    for _ in tqdm(range(count), desc="promotes", unit="promote"):
        time.sleep(chance.uniform(0.0, POLL_INTERVAL_S))
        publish(root, 1, 0.0)
        agreement.promote(time.monotonic(), registry.aliases(NAME)["champion"], len(both))
        end = time.monotonic() + TIMEOUT_S
        while not agreement.settled:
            agreement.observe(time.monotonic(), [probe.version() for probe in probes])
            if time.monotonic() > end:
                raise SystemExit("a promotion did not reach both instances")
            time.sleep(ASK_EVERY_S)
    found = agreement.take_times()
    print(f"\n## Promotes, {count} of versions just published; the poll interval is {POLL_INTERVAL_S:g} s\n")
    print("| | median (s) | at most (s) |\n|---|---|---|")
    for words, times in (
        ("from the promote to an instance's first answer with it", found["reached_s"]),
        ("the instances disagree", found["apart_s"] or [0.0]),
    ):
        print(f"| {words} | {statistics.median(times):.2f} | {max(times):.2f} |")


def kills(folder: Path, both: Sequence[Instance], count: int) -> bool:
    """Kill one instance after the other under load. Return True if no request failed and readiness was always right."""
    away_s, wrong, unanswered = [], 0, 0
    with nginx(folder / "two", both) as port:
        wrk_run = WrkProcess(folder, port, A_DAY_S)
        try:
            for number in tqdm(range(count), desc="kills", unit="kill"):
                killed, other = both[number % 2], VersionProbe(both[1 - number % 2].port)
                killed.kill()
                began = time.monotonic()
                killed_probe = VersionProbe(killed.port)
                wrong += killed_probe.ready() is not None  # the port must not answer
                killed.launch()
                unanswered += _wait_until_ready(killed, killed_probe, other)
                wrong += killed_probe.version() is None  # it has just answered that it is ready
                away_s.append(time.monotonic() - began)
                for probe in (killed_probe, other):
                    probe.close()
        finally:
            wrk_run.stop()
        report = wrk_run.report()
    refused, again = count_refused_and_retried(folder / "two")
    print(f"\n## SIGKILLs, {count} under load in {report.took_s:.0f} s\n")
    print("| | |\n|---|---|")
    print(f"| requests; failed | {report.requests:,}; {report.failed} |")
    print(f"| answered otherwise than with 200; sent to the second instance | {refused}; {again} |")
    print(f"| p50; p99 | {report.p50_ms:.2f} ms; {report.p99_ms:.1f} ms |")
    print(f"| until the killed one predicts again, median; at most | {_spread(away_s)} |")
    print(f"| times the other one did not answer meanwhile | {unanswered} |")
    print(f"| times `/readyz` did not tell the truth | {wrong} |")
    return not (report.failed or unanswered or wrong)


def _wait_until_ready(killed: Instance, killed_probe: VersionProbe, other: VersionProbe) -> int:
    """Wait until the instance is ready. Return how often the other one did not predict meanwhile."""
    unanswered, end = 0, time.monotonic() + TIMEOUT_S
    while killed_probe.ready() != 200:
        if time.monotonic() > end:
            raise SystemExit(f"the instance on port {killed.port} does not come back; see {killed.log}")
        unanswered += other.version() is None
        time.sleep(ASK_EVERY_S)
    return unanswered


def _spread(times_s: Sequence[float]) -> str:
    return f"{statistics.median(times_s):.2f} s; {max(times_s):.2f} s"


def main() -> None:
    """Measure and print. Fail if a request was lost or readiness was wrong."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=5, help="rounds of throughput")
    parser.add_argument("--seconds", type=int, default=3, help="length of one run of wrk")
    parser.add_argument("--promotes", type=int, default=20, help="number of promotions")
    parser.add_argument("--kills", type=int, default=20, help="number of kills")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder, root = Path(name), Path(name) / "models"
        shutil.copytree(ROOT / "models", root)
        with instances(2, folder, root, poll_interval_s=POLL_INTERVAL_S) as both:
            throughput(folder, both, options.rounds, options.seconds)
            promotes(root, both, options.promotes)
            passed = kills(folder, both, options.kills)
    if not passed:
        raise SystemExit(1)


if __name__ == "__main__":
    main()
