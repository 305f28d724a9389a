"""Spans of requests reach an exporter in this process, and a collector."""

import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, HTTPServer
from typing import ClassVar

import pytest
from fastapi.testclient import TestClient
from opentelemetry.sdk.trace import ReadableSpan, TracerProvider
from opentelemetry.sdk.trace.export import SimpleSpanProcessor
from opentelemetry.sdk.trace.export.in_memory_span_exporter import InMemorySpanExporter

from service.app import create_app
from service.inference.loaded_models import LoadedModels
from service.observability.tracing import Tracing, exporting
from service.registry.registry import Registry
from service.settings import Settings

BODY = {"pusher": {"x": -0.075, "y": 0.0, "angle": 0.0}, "context": {"descriptor": "1a2b3c4a"}}
TRACE, SPAN = "4bf92f3577b34da6a3ce929d0e0e4736", "00f067aa0ba902b7"


@pytest.fixture
def exporter() -> InMemorySpanExporter:
    """Return an exporter that keeps spans in memory."""
    return InMemorySpanExporter()


@pytest.fixture
def traced(served: tuple[Registry, LoadedModels], exporter: InMemorySpanExporter) -> Iterator[TestClient]:
    """Return a client of the application with spans."""
    provider = TracerProvider()
    provider.add_span_processor(SimpleSpanProcessor(exporter))
    app = create_app(Settings(poll_interval_s=3600), served[1], trace=lambda rings: Tracing(rings, provider))
    with TestClient(app, raise_server_exceptions=False) as found:
        yield found


def only_span(exporter: InMemorySpanExporter) -> ReadableSpan:
    """Return the only span."""
    (span,) = exporter.get_finished_spans()
    return span


def test_a_request_is_a_span_in_its_callers_trace(traced: TestClient, exporter: InMemorySpanExporter) -> None:
    """The span of a request has the trace of its caller, and route, status and model as attributes."""
    headers = {"traceparent": f"00-{TRACE}-{SPAN}-01", "X-Request-ID": "one"}
    assert traced.post("/v1/predict", json=BODY, headers=headers).status_code == 200
    span = only_span(exporter)
    assert span.name == "POST /v1/predict"
    assert span.context is not None
    assert span.parent is not None
    assert (f"{span.context.trace_id:032x}", f"{span.parent.span_id:016x}") == (TRACE, SPAN)
    assert dict(span.attributes or {}) == {
        "http.request.method": "POST",
        "http.route": "/v1/predict",
        "http.response.status_code": 200,
        "cazsl.request_id": "one",
        "cazsl.model": "push-indicator",
        "cazsl.version": 1,
        "cazsl.pushes": 1,
    }


def test_a_refusal_is_a_span_with_its_code_and_without_its_path(
    traced: TestClient, exporter: InMemorySpanExporter
) -> None:
    """The span of a refusal has its code and no path, and is a root span without a valid trace."""
    traced.get("/secret-token-in-a-path", headers={"traceparent": "made up"})
    span = only_span(exporter)
    assert (span.name, span.parent) == ("GET unknown", None)
    attributes = dict(span.attributes or {})
    assert (attributes["http.response.status_code"], attributes["error.type"]) == (404, "no_such_route")
    assert "secret-token" not in str(span.to_json())


class Collector(BaseHTTPRequestHandler):
    """A collector that keeps the spans that it receives."""

    bodies: ClassVar[list[tuple[str, bytes]]] = []

    def do_POST(self) -> None:
        """Keep a batch of spans."""
        self.bodies.append((self.path, self.rfile.read(int(self.headers["Content-Length"]))))
        self.send_response(200)
        self.end_headers()

    def log_message(self, *_: object) -> None:
        """Log no line."""


def test_spans_reach_a_collector_before_the_provider_ends() -> None:
    """Spans are sent by OTLP over HTTP to exactly the given address, at the latest at shutdown."""
    with HTTPServer(("127.0.0.1", 0), Collector) as server:
        serving = threading.Thread(target=server.serve_forever)
        serving.start()
        provider = exporting(f"http://127.0.0.1:{server.server_port}/v1/traces")
        provider.get_tracer("test").start_span("POST /v1/predict").end()
        provider.shutdown()
        server.shutdown()
        serving.join()
    ((path, body),) = Collector.bodies
    assert path == "/v1/traces"
    assert b"POST /v1/predict" in body
    assert b"cazsl" in body
