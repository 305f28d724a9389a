"""Spans for OpenTelemetry, where the operator asks for them (extra ``otel``): one per request, in its caller's trace.

A span has the route's template, the status, the request's id and the model that answered; never a path, a body or a
key. The only room that imports OpenTelemetry, and it is imported only when it is wanted.
"""

from http import HTTPStatus
from typing import Final

from opentelemetry.exporter.otlp.proto.http.trace_exporter import OTLPSpanExporter
from opentelemetry.sdk.resources import Resource
from opentelemetry.sdk.trace import TracerProvider
from opentelemetry.sdk.trace.export import BatchSpanProcessor
from opentelemetry.trace import SpanKind, Status, StatusCode
from opentelemetry.trace.propagation.tracecontext import TraceContextTextMapPropagator
from starlette.types import ASGIApp, Message, Receive, Scope, Send

import service
from service.observability.telemetry import route_of

_TRACE_HEADERS: Final = frozenset((b"traceparent", b"tracestate"))


def exporting(endpoint: str) -> TracerProvider:
    """Spans to a collector's address (OTLP over HTTP), in batches, from a thread of its own.

    A collector that is gone costs spans, never requests.
    """
    provider = TracerProvider(
        resource=Resource.create({"service.name": "cazsl", "service.version": service.__version__})
    )
    provider.add_span_processor(BatchSpanProcessor(OTLPSpanExporter(endpoint)))
    return provider


class Tracing:
    """The ring around all others: a span for every request."""

    def __init__(self, app: ASGIApp, provider: TracerProvider) -> None:
        self._app = app
        self._provider = provider
        self._tracer = provider.get_tracer("cazsl", service.__version__)
        self._propagator = TraceContextTextMapPropagator()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one request."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        carrier = {name.decode(): value.decode("latin-1") for name, value in scope["headers"] if name in _TRACE_HEADERS}
        status = 0

        async def send_and_look(message: Message) -> None:
            """Send on, and note the status."""
            nonlocal status
            if message["type"] == "http.response.start":
                status = message["status"]
            await send(message)

        parent = self._propagator.extract(carrier)
        with self._tracer.start_as_current_span(scope["method"], parent, SpanKind.SERVER) as span:
            await self._app(scope, receive, send_and_look)
            state = scope["state"]
            noted = state.get("log", {})
            route = route_of(scope)
            span.update_name(f"{scope['method']} {route}")
            span.set_attributes({"http.request.method": scope["method"], "http.route": route})
            span.set_attributes({"http.response.status_code": status, "cazsl.request_id": state["request_id"]})
            span.set_attributes(
                {f"cazsl.{name}": noted[name] for name in ("model", "version", "pushes") if name in noted}
            )
            if "refusal" in state:
                span.set_attribute("error.type", state["refusal"])
            if status >= HTTPStatus.INTERNAL_SERVER_ERROR:
                span.set_status(Status(StatusCode.ERROR))
