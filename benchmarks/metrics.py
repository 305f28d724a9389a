"""What counting costs a single push: ``python -m benchmarks.metrics``.

A push goes through the whole app in process, without sockets, with metrics and without, in turns of a hundred; beside
it stands what the counting takes by itself. Ratios of one run; the smaller of many turns is taken, since machines are
shared.
"""

import asyncio
import io
import json
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from starlette.types import Message

from service.app import Service, create_app
from service.loaded_models import LoadedModels
from service.metrics import RequestMetrics, render
from service.predictor import OnnxPredictor
from service.registry import Registry
from service.settings import Settings
from service.stopwatch import Parts, listen, took
from service.telemetry import RequestLog, RequestTelemetry

MODELS = Path(__file__).resolve().parent.parent / "models"
BODY = json.dumps({"pusher": {"x": -0.075, "y": 0.0, "angle": 0.0}, "context": {"descriptor": "1a2b3c4a"}}).encode()
TURNS, PUSHES = 400, 100
NOTED = {"model": "push-indicator", "version": 1, "pushes": 1}


class Nobody:
    """Counts nothing."""

    def note(self, route: str, status: int, duration_s: float, noted: Mapping[str, Any], parts: Parts) -> None:
        """Nothing."""

    def refuse(self, reason: str) -> None:
        """Nothing."""


async def push(rings: RequestTelemetry) -> None:
    """One request, as a server would hand it in."""
    headers = [(b"host", b"localhost"), (b"content-type", b"application/json"), (b"accept", b"*/*")]
    scope = {"type": "http", "method": "POST", "path": "/v1/predict", "headers": headers, "client": ("127.0.0.1", 1)}

    async def receive() -> Message:
        """What the client sends."""
        return {"type": "http.request", "body": BODY, "more_body": False}

    async def send(message: Message) -> None:
        """What the client is sent."""
        if message["type"] == "http.response.start" and message["status"] != 200:
            raise SystemExit(f"no prediction: {message}")

    await rings(scope, receive, send)


async def turn(rings: RequestTelemetry) -> float:
    """Seconds a push, over a turn."""
    began = time.perf_counter()
    for _ in range(PUSHES):
        await push(rings)
    return (time.perf_counter() - began) / PUSHES


def counting(metrics: RequestMetrics) -> float:
    """Seconds that counting one push takes by itself: two looks at the clock, a part, a note."""
    began = time.perf_counter()
    for _ in range(10_000):
        parts: Parts = []
        listen(parts)
        start = time.perf_counter()
        took("inference", time.perf_counter() - start)
        metrics.note("/v1/predict", 200, 0.0001, NOTED, parts)
    return (time.perf_counter() - began) / 10_000


async def main() -> None:
    """Measure and print."""
    models = LoadedModels(Registry(MODELS), OnnxPredictor)
    models.refresh()
    app = create_app(Settings(), models, RequestLog(io.StringIO()))
    assert isinstance(app, Service)  # noqa: S101  # what create_app makes
    counted = app.rings
    assert isinstance(counted, RequestTelemetry)  # noqa: S101
    uncounted = RequestTelemetry(counted.app, _no_error, RequestLog(io.StringIO()), Nobody())
    times: dict[str, list[float]] = {"with": [], "without": []}
    for number in range(TURNS):
        pair = [("with", counted), ("without", uncounted)]
        for name, rings in pair if number % 2 else reversed(pair):
            times[name].append(await turn(rings))
    with_us, without_us = min(times["with"]) * 1e6, min(times["without"]) * 1e6
    alone_us = min(counting(app.state.requests) for _ in range(20)) * 1e6
    began = time.perf_counter()
    size = len(render(app.state.metrics))
    scrape_ms = (time.perf_counter() - began) * 1e3
    print(f"a push without counting   {without_us:7.2f} us")
    print(f"a push with counting      {with_us:7.2f} us   {100 * (with_us / without_us - 1):+.1f} %")
    print(f"counting by itself        {alone_us:7.2f} us   {100 * alone_us / without_us:.1f} % of a push")
    print(f"a scrape of {size} bytes   {scrape_ms:7.2f} ms")


async def _no_error(*_: object) -> None:
    raise SystemExit("a push failed")


if __name__ == "__main__":
    asyncio.run(main())
