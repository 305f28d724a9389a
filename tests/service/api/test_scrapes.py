"""Scrapes of the metrics run in one thread at most, and the separate port for metrics is bounded."""

import asyncio
import io
import socket
import threading
from collections.abc import Iterator
from pathlib import Path

import httpx2
import pytest
import uvicorn
from prometheus_client import CollectorRegistry
from prometheus_client.metrics_core import Metric
from prometheus_client.registry import Collector

from service.api import scrapes
from service.api.scrapes import Scrapes
from service.app import create_app
from service.errors import DeadlineError
from service.observability.logs import RequestLog
from service.settings import Settings
from service.transport.draining import DrainingServer
from tests.fakes import fake_models
from tests.running_service import PATIENCE_S, wait_until


class Held(Collector):
    """A collector that waits until a test releases it."""

    def __init__(self) -> None:
        self.released = threading.Event()
        self.scrapes = 0

    def collect(self) -> Iterator[Metric]:
        """Wait, and return no metrics."""
        self.scrapes += 1
        self.released.wait()
        yield from ()


def registry(collector: Collector) -> CollectorRegistry:
    """Return a registry of one collector."""
    found = CollectorRegistry(auto_describe=False)
    found.register(collector)
    return found


def test_scrapes_at_the_same_time_share_one_text() -> None:
    """Many scrapes take one thread, and the event loop goes on meanwhile."""
    held = Held()

    async def scenario() -> None:
        """Run the scenario in an event loop."""
        found = Scrapes(registry(held))
        running = [asyncio.ensure_future(found.text()) for _ in range(50)]
        while not held.scrapes:
            await asyncio.sleep(0.001)
        held.released.set()
        assert set(await asyncio.gather(*running)) == {b""}
        assert held.scrapes == 1
        await found.text()
        assert held.scrapes == 2

    asyncio.run(scenario())


def test_a_scrape_that_hangs_is_refused_in_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """A scrape ends after its time, and later ones take no other thread."""
    monkeypatch.setattr(scrapes, "LIMIT_S", 0.01)
    held = Held()

    async def scenario() -> None:
        """Run the scenario in an event loop."""
        found = Scrapes(registry(held))
        for _ in range(3):
            with pytest.raises(DeadlineError):
                await found.text()
        assert held.scrapes == 1
        held.released.set()

    asyncio.run(scenario())


@pytest.fixture
def port(tmp_path: Path) -> Iterator[int]:
    """Run a server with a separate port for metrics, and return that port."""
    app = create_app(Settings(poll_interval_s=3600), fake_models(tmp_path)[1], RequestLog(io.StringIO()))
    listening = socket.create_server(("127.0.0.1", 0))
    main, metrics = (
        uvicorn.Config(application, port=0, log_config=None, access_log=False, http=connections)
        for application, connections in ((app, app.connections), (app.metrics, app.metrics_connections))
    )
    server = DrainingServer(main, 0.0, lambda: None, lambda _: None, [(listening, metrics)])
    thread = threading.Thread(target=server.run)
    thread.start()
    wait_until(lambda: server.started)
    yield int(listening.getsockname()[1])
    server.should_exit = True
    thread.join()


def test_the_separate_port_has_metrics_only(port: int) -> None:
    """Other paths and methods are refused, and each answer has its id."""
    with httpx2.Client(base_url=f"http://127.0.0.1:{port}", timeout=PATIENCE_S) as client:
        found = client.get("/metrics")
        assert (found.status_code, "\ncazsl_ready 1.0\n" in found.text) == (200, True)
        assert found.headers["content-type"] == "text/plain; version=0.0.4; charset=utf-8"
        assert client.head("/metrics").status_code == 200
        assert client.get("/v1/models").status_code == 404
        refused = client.post("/metrics", content=b"x" * 1000)
        assert (refused.status_code, refused.headers["allow"]) == (405, "GET, HEAD")
        assert refused.headers["x-request-id"]
        text = client.get("/metrics").text
        assert 'cazsl_requests_total{route="/metrics",status="200"} ' in text


def test_idle_connections_take_no_thread_and_make_room(port: int) -> None:
    """Hundreds of idle connections to the metrics port are bounded, and a scrape is answered beside them."""
    threads = threading.active_count()
    idle = [socket.create_connection(("127.0.0.1", port), timeout=PATIENCE_S) for _ in range(300)]
    with httpx2.Client(timeout=PATIENCE_S) as client:
        assert client.get(f"http://127.0.0.1:{port}/metrics").status_code == 200
    assert threading.active_count() <= threads + 1
    ended = 0
    for connection in idle:
        connection.setblocking(False)
        try:
            ended += connection.recv(1) == b""
        except BlockingIOError:
            pass
        except ConnectionError:
            ended += 1
        connection.close()
    assert ended >= 300 - 32
