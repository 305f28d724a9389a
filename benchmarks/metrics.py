"""Metrics: their cost per single push, by ``python -m benchmarks.metrics``.

wrk sends requests to two services in turn, of which one does not count. Printed are medians of processor time and of
throughput as ratios within a round, and beside them the time of counting by itself and of a scrape. wrk must be
installed.
"""

import sys
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path
from statistics import median

from benchmarks.http_load import OURS, PUSH, Load, WrkFigures, free_port, run_wrk, server
from service.cli.main import main as cazsl
from service.observability.metrics import RequestMetrics
from service.observability.prometheus import exposition, render
from service.observability.records import RequestRecord
from service.observability.timings import Timings

ROUNDS, SECONDS, CONNECTIONS = 20, 2, 16
RECORDS = 10_000


def serve_uncounted() -> None:
    """Run the command of the service with counting switched off."""

    def note(_: RequestMetrics, __: RequestRecord) -> None:
        """Count no request."""

    RequestMetrics.note = note  # type: ignore[assignment,method-assign]  # in a process of its own
    cazsl()


def measure_services() -> dict[str, list[WrkFigures]]:
    """Measure both services by turns, through sockets."""
    uncounted = ["-c", "from benchmarks.metrics import serve_uncounted as serve; serve()", "serve"]
    runs: dict[str, list[WrkFigures]] = {"counting": [], "not counting": []}
    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        script = Load("/v1/predict", PUSH, {"Content-Type": "application/json"}).script(Path(folder), "push")
        commands = zip(runs, (OURS, uncounted), strict=True)
        servers = {name: stack.enter_context(server([sys.executable, *words], free_port())) for name, words in commands}
        for number in range(ROUNDS):
            for name in list(servers) if number % 2 else reversed(servers):
                runs[name].append(run_wrk(servers[name], script, "/v1/predict", CONNECTIONS, SECONDS))
    return runs


def single_push_record() -> RequestRecord:
    """Return the record of a single push."""
    timings: Timings = [("inference", 1e-5)]
    answered = {"model": "push-indicator", "version": 1, "pushes": 1, "status": 200, "duration_s": 1e-4}
    return RequestRecord("one", "POST", route="/v1/predict", timings=timings, **answered)  # type: ignore[arg-type]


def counting_s(metrics: RequestMetrics) -> float:
    """Return the time of counting one push by itself, in s."""
    records = [single_push_record() for _ in range(RECORDS)]
    began = time.perf_counter()
    for record in records:
        metrics.note(record)
    return (time.perf_counter() - began) / RECORDS


def main() -> None:
    """Measure and print the figures."""
    counted, free = measure_services().values()
    cost = median(one.cpu_us / other.cpu_us - 1.0 for one, other in zip(counted, free, strict=True))
    lost = median(1.0 - one.requests_per_s / other.requests_per_s for one, other in zip(counted, free, strict=True))
    metrics = RequestMetrics(lambda *_: True)
    print(f"a push without counting   {median(one.cpu_us for one in free):7.2f} us, median of {ROUNDS} rounds")
    print(f"counting adds             {100 * cost:+7.1f} % of processor time")
    print(f"and takes                 {100 * lost:7.1f} % of throughput")
    print(f"counting by itself        {1e6 * min(counting_s(metrics) for _ in range(20)):7.2f} us")
    began = time.perf_counter()
    size = len(render(exposition(metrics)))
    print(f"a scrape of {size} bytes   {1e3 * (time.perf_counter() - began):7.2f} ms")


if __name__ == "__main__":
    main()
