"""What counting costs a single push: ``python -m benchmarks.metrics``.

Two services, one of which does not count, are asked by wrk in turns: medians of processor time and of throughput, as
ratios of one run. Beside them stands what the counting takes by itself, and a scrape. wrk has to be installed.
"""

import sys
import tempfile
import time
from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from statistics import median
from typing import Any

from benchmarks.asking import OURS, PUSH, Figures, Load, ask, free_port, server
from service.cli.main import main as cazsl
from service.observability.metrics import RequestMetrics
from service.observability.prometheus import exposition, render

ROUNDS, SECONDS, CONNECTIONS = 20, 2, 16
LINES = 10_000
LINE = {"route": "/v1/predict", "status": 200, "model": "push-indicator", "version": 1, "pushes": 1}


def serve_uncounted() -> None:
    """The service's own command, but that it counts nothing."""

    def note(_: RequestMetrics, __: Mapping[str, Any]) -> None:
        """Nothing."""

    RequestMetrics.note = note  # type: ignore[assignment,method-assign]  # in a process of its own
    cazsl()


def through_sockets() -> dict[str, list[Figures]]:
    """Both services by turns, as clients ask them."""
    uncounted = ["-c", "from benchmarks.metrics import serve_uncounted as serve; serve()", "serve"]
    runs: dict[str, list[Figures]] = {"counting": [], "not counting": []}
    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        script = Load("/v1/predict", PUSH, {"Content-Type": "application/json"}).script(Path(folder), "push")
        commands = zip(runs, (OURS, uncounted), strict=True)
        servers = {name: stack.enter_context(server([sys.executable, *words], free_port())) for name, words in commands}
        for number in range(ROUNDS):
            for name in list(servers) if number % 2 else reversed(servers):
                runs[name].append(ask(servers[name], script, "/v1/predict", CONNECTIONS, SECONDS))
    return runs


def alone_s(metrics: RequestMetrics) -> float:
    """Seconds that counting one push takes by itself."""
    lines = [LINE | {"duration_ms": 0.1, "inference_ms": 0.01} for _ in range(LINES)]
    began = time.perf_counter()
    for line in lines:
        metrics.note(line)
    return (time.perf_counter() - began) / LINES


def main() -> None:
    """Measure and print."""
    counted, free = through_sockets().values()
    cost = median(one.cpu_us / other.cpu_us - 1.0 for one, other in zip(counted, free, strict=True))
    lost = median(1.0 - one.requests_per_s / other.requests_per_s for one, other in zip(counted, free, strict=True))
    metrics = RequestMetrics(lambda *_: True)
    print(f"a push without counting   {median(one.cpu_us for one in free):7.2f} us, median of {ROUNDS} rounds")
    print(f"counting adds             {100 * cost:+7.1f} % of processor time")
    print(f"and takes                 {100 * lost:7.1f} % of throughput")
    print(f"counting by itself        {1e6 * min(alone_s(metrics) for _ in range(20)):7.2f} us")
    began = time.perf_counter()
    size = len(render(exposition(metrics)))
    print(f"a scrape of {size} bytes   {1e3 * (time.perf_counter() - began):7.2f} ms")


if __name__ == "__main__":
    main()
