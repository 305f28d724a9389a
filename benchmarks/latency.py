"""What a prediction costs over HTTP, beside an empty FastAPI endpoint with the same schemas.

    python benchmarks/latency.py [--seconds 5] [--rounds 3]

Starts both servers on loopback, one process each, and asks them in turn with wrk at 1 and 16 connections, round by
round, so that a machine whose speed drifts drifts for both. Prints the median over the rounds.
"""

import argparse
import http.client
import os
import re
import shutil
import socket
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import uvicorn
from fastapi import FastAPI

from service.requests import PredictRequest
from service.schemas import PredictResponse

ROOT = Path(__file__).resolve().parent.parent
BODY = '{"pusher": {"x": -0.075, "y": 0.0, "angle": 0.0}, "context": {"descriptor": "1a2b3c4a"}}'
LUA = f"""
wrk.method = "POST"
wrk.body = '{BODY}'
wrk.headers["Content-Type"] = "application/json"
done = function(summary, latency, requests)
  local failed = summary.errors.status + summary.errors.connect + summary.errors.read + summary.errors.timeout
  io.write(string.format("FIGURES %d %d %d %d %d\\n", latency:percentile(50), latency:percentile(99),
    summary.requests, summary.duration, failed))
end
"""
CONNECTIONS = (1, 16)


@dataclass(frozen=True)
class Figures:
    """One run of wrk."""

    p50_us: int
    p99_us: int
    requests_per_s: float


def empty_app() -> FastAPI:
    """An endpoint that parses the same request and renders the same response, and predicts nothing."""
    app = FastAPI()
    constant = PredictResponse.model_validate(
        {
            "model": {"name": "push-indicator", "version": 1},
            "frame": "object",
            "mean": {"x": 0.026867030516266823, "y": 0.000977544579654932, "angle": 0.04581319913268089},
            "std": {"x": 0.004548678174614906, "y": 0.0024233844596892595, "angle": 0.1610754281282425},
        }
    )

    @app.post("/v1/predict")
    async def predict(body: PredictRequest) -> PredictResponse:
        """Predict nothing."""
        return constant

    return app


@contextmanager
def server(arguments: list[str], port: int) -> Iterator[None]:
    """A server process on a port, from its first answer to its end."""
    process = subprocess.Popen(
        [sys.executable, *arguments],
        cwd=ROOT,
        env={**os.environ, "CAZSL_PORT": str(port), "PYTHONPATH": str(ROOT)},
        stderr=subprocess.DEVNULL,
    )
    try:
        wait_for(port)
        yield
    finally:
        process.terminate()
        process.wait()


def wait_for(port: int) -> None:
    """Wait until a prediction is answered."""
    for _ in range(600):
        try:
            connection = http.client.HTTPConnection("127.0.0.1", port, timeout=5)
            connection.request("POST", "/v1/predict", BODY, {"Content-Type": "application/json"})
            if connection.getresponse().status == 200:
                return
        except OSError:
            pass
        time.sleep(0.1)
    raise SystemExit(f"nothing answers on port {port}")


def ask(wrk: str, script: Path, port: int, connections: int, seconds: int) -> Figures:
    """One run of wrk, all answers being 200."""
    command = [
        wrk,
        "-t1",
        f"-c{connections}",
        f"-d{seconds}s",
        "-s",
        str(script),
        f"http://127.0.0.1:{port}/v1/predict",
    ]
    output = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    found = re.search(r"FIGURES (\d+) (\d+) (\d+) (\d+) (\d+)", output)
    if found is None or int(found[5]):
        raise SystemExit(f"wrk saw failed requests:\n{output}")
    return Figures(int(found[1]), int(found[2]), int(found[3]) / (int(found[4]) / 1e6))


def free_port() -> int:
    """A port that nobody listens on."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=int, default=5, help="length of one run of wrk")
    parser.add_argument("--rounds", type=int, default=3, help="runs of each")
    parser.add_argument("--empty", type=int, metavar="PORT", help="only serve the empty endpoint, on this port")
    options = parser.parse_args()
    if options.empty:
        uvicorn.run(empty_app(), port=options.empty, log_config=None, access_log=False, server_header=False)
        return
    wrk = shutil.which("wrk") or sys.exit("wrk is not installed; apt-get install wrk")
    ports = {"predict": free_port(), "empty": free_port()}
    runs: dict[tuple[str, int], list[Figures]] = {(name, count): [] for count in CONNECTIONS for name in ports}
    serve = ["-c", "from service.cli import main; main()", "serve"]
    with (
        tempfile.TemporaryDirectory() as folder,
        server(serve, ports["predict"]),
        server([__file__, "--empty", str(ports["empty"])], ports["empty"]),
    ):
        script = Path(folder) / "push.lua"
        script.write_text(LUA)
        for _ in range(options.rounds):
            for (name, count), figures in runs.items():
                figures.append(ask(wrk, script, ports[name], count, options.seconds))
    print("| connections | endpoint | p50 (ms) | p99 (ms) | requests/s | throughput of empty |")
    print("|---|---|---|---|---|---|")
    for (name, count), figures in runs.items():
        p50, p99, rate = (
            statistics.median(getattr(run, field) for run in figures) for field in Figures.__annotations__
        )
        empty = statistics.median(run.requests_per_s for run in runs["empty", count])
        print(f"| {count} | {name} | {p50 / 1e3:.2f} | {p99 / 1e3:.2f} | {rate:.0f} | {rate / empty:.2f} |")


if __name__ == "__main__":
    main()
