"""What a second instance gives, how long two disagree, and what `kill -9` of one costs.

    python -m benchmarks.replicas [--rounds 5] [--seconds 3] [--promotes 20] [--kills 20]

Two instances over one registry, behind nginx, asked by wrk. Throughput: one instance behind nginx and both, in turn,
round by round, with one push a request and with a thousand. wrk and nginx share the processors with them: on two, and
with one push a request, they take as much as an instance, and a second one has nothing left to run on.
Promotes: a version is published and becomes the champion at once, at a random moment of the instances' polls; each
instance is asked a hundred times a second until it answers with it. Kills: one instance after the other is killed under
load and started again; while it is away nobody may answer at its door, and once it says that it is ready it must
predict. It fails if a request failed or readiness did not tell the truth. nginx and wrk come with the distribution.
"""

import argparse
import os
import random
import shutil
import statistics
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from tqdm import tqdm

from benchmarks.agreement import Agreement, Witness
from benchmarks.asking import ROOT
from benchmarks.cluster import ONE_PUSH, Asking, Instance, instances, nginx, odd_answers
from benchmarks.serving import ROWS, batch_loads
from benchmarks.swap import NAME, publish
from service.registry.registry import Registry

A_DAY_S = 24 * 3600
POLL_INTERVAL_S = 2.0
ASK_EVERY_S = 0.01
PATIENCE_S = 60.0


def throughput(folder: Path, both: Sequence[Instance], rounds: int, seconds: int) -> None:
    """One instance and both, in turn."""
    loads = {"1": ONE_PUSH, f"{ROWS:,}": batch_loads()["JSON"]}
    found: dict[str, list[tuple[float, float]]] = {pushes: [] for pushes in loads}
    with nginx(folder / "one", both[:1]) as one, nginx(folder / "two", both) as two:
        for _ in tqdm(range(rounds), desc="throughput", unit="round"):
            for pushes, load in loads.items():
                alone, together = (_requests_per_s(Asking(folder, port, seconds, None, load)) for port in (one, two))
                found[pushes].append((alone, together))
    print(f"\n## Throughput, {rounds} rounds of {seconds} s each, {os.cpu_count()} processors\n")
    print("| pushes a request | one instance (requests/s) | two | two to one, median (range) |\n|---|---|---|---|")
    for pushes, rates in found.items():
        ratios = [together / alone for alone, together in rates]
        first, second = (statistics.median(side) for side in zip(*rates, strict=True))
        span = f"{min(ratios):.2f} to {max(ratios):.2f}"
        print(f"| {pushes} | {first:.0f} | {second:.0f} | {statistics.median(ratios):.2f} ({span}) |")


def _requests_per_s(asking: Asking) -> float:
    """What it saw, nothing having failed."""
    seen = asking.seen()
    if seen.failed:
        raise SystemExit(f"{seen.failed} requests failed")
    return seen.requests_per_s


def promotes(root: Path, both: Sequence[Instance], count: int) -> None:
    """Time until each instance serves what was promoted, and how long they disagree."""
    registry, agreement, chance = Registry(root), Agreement(), random.Random(0)  # noqa: S311
    witnesses = [Witness(instance.port) for instance in both]
    for _ in tqdm(range(count), desc="promotes", unit="promote"):
        time.sleep(chance.uniform(0.0, POLL_INTERVAL_S))
        publish(root, 1, 0.0)
        agreement.promote(time.monotonic(), registry.aliases(NAME)["champion"], len(both))
        end = time.monotonic() + PATIENCE_S
        while not agreement.settled:
            agreement.see(time.monotonic(), [witness.version() for witness in witnesses])
            if time.monotonic() > end:
                raise SystemExit("a promote did not reach both instances")
            time.sleep(ASK_EVERY_S)
    found = agreement.take()
    print(f"\n## Promotes, {count} of versions just published; the poll interval is {POLL_INTERVAL_S:g} s\n")
    print("| | median (s) | at most (s) |\n|---|---|---|")
    for words, times in (
        ("from the promote to an instance's first answer with it", found["reached_s"]),
        ("the instances disagree", found["apart_s"] or [0.0]),
    ):
        print(f"| {words} | {statistics.median(times):.2f} | {max(times):.2f} |")


def kills(folder: Path, both: Sequence[Instance], count: int) -> bool:
    """SIGKILL of one instance after the other under load; whether nothing was lost and nobody lied."""
    away_s, lies, silent = [], 0, 0
    with nginx(folder / "two", both) as port:
        asking = Asking(folder, port, A_DAY_S)
        try:
            for number in tqdm(range(count), desc="kills", unit="kill"):
                killed, other = both[number % 2], Witness(both[1 - number % 2].port)
                killed.kill()
                began = time.monotonic()
                door = Witness(killed.port)
                lies += door.ready() is not None  # nobody may answer there
                killed.launch()
                silent += _wait_until_ready(killed, door, other)
                lies += door.version() is None  # it has just said that it is ready
                away_s.append(time.monotonic() - began)
                for witness in (door, other):
                    witness.close()
        finally:
            asking.stop()
        seen = asking.seen()
    refused, again = odd_answers(folder / "two")
    print(f"\n## SIGKILLs, {count} under load in {seen.took_s:.0f} s\n")
    print("| | |\n|---|---|")
    print(f"| requests; failed | {seen.requests:,}; {seen.failed} |")
    print(f"| answered otherwise than with 200; sent to the second instance | {refused}; {again} |")
    print(f"| p50; p99 | {seen.p50_ms:.2f} ms; {seen.p99_ms:.1f} ms |")
    print(f"| until the killed one predicts again, median; at most | {_spread(away_s)} |")
    print(f"| times the other one did not answer meanwhile | {silent} |")
    print(f"| times `/readyz` did not tell the truth | {lies} |")
    return not (seen.failed or silent or lies)


def _wait_until_ready(killed: Instance, door: Witness, other: Witness) -> int:
    """Wait until it says that it is ready; how often the other did not answer a prediction meanwhile."""
    silent, end = 0, time.monotonic() + PATIENCE_S
    while door.ready() != 200:
        if time.monotonic() > end:
            raise SystemExit(f"the instance on port {killed.port} does not come back; see {killed.log}")
        silent += other.version() is None
        time.sleep(ASK_EVERY_S)
    return silent


def _spread(times_s: Sequence[float]) -> str:
    return f"{statistics.median(times_s):.2f} s; {max(times_s):.2f} s"


def main() -> None:
    """Measure, print, and fail if anything was lost."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=5, help="of one instance and of two")
    parser.add_argument("--seconds", type=int, default=3, help="length of one run of wrk")
    parser.add_argument("--promotes", type=int, default=20, help="how many")
    parser.add_argument("--kills", type=int, default=20, help="how many")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder, root = Path(name), Path(name) / "models"
        shutil.copytree(ROOT / "models", root)
        with instances(2, folder, root, poll_interval_s=POLL_INTERVAL_S) as both:
            throughput(folder, both, given.rounds, given.seconds)
            promotes(root, both, given.promotes)
            truthful = kills(folder, both, given.kills)
    if not truthful:
        raise SystemExit(1)


if __name__ == "__main__":
    main()
