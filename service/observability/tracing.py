"""Spans for OpenTelemetry (extra ``otel``): one per request, in the trace of its caller.

A span has the template of the route, the status, the request id and the model that answered. It never has a path, a
body or a key. Only this module imports OpenTelemetry, and it is imported only if the operator sets an endpoint.
"""

import logging
from http import HTTPStatus
from typing import Final

from opentelemetry.exporter.otlp.proto.http.trace_exporter import OTLPSpanExporter
from opentelemetry.sdk.resources import Resource
from opentelemetry.sdk.trace import TracerProvider
from opentelemetry.sdk.trace.export import BatchSpanProcessor
from opentelemetry.trace import INVALID_SPAN, Span, SpanKind, Status, StatusCode, use_span
from opentelemetry.trace.propagation.tracecontext import TraceContextTextMapPropagator
from starlette.types import ASGIApp, Receive, Scope, Send

import service
from service.observability.records import RequestRecord, record_of

_TRACE_HEADERS: Final = frozenset((b"traceparent", b"tracestate"))

logger = logging.getLogger(__name__)


def exporting(endpoint: str) -> TracerProvider:
    """Create a provider that sends spans to a collector (OTLP over HTTP) in batches, in a background thread.

    If the collector cannot be reached, spans are lost and requests are answered as before.
    """
    provider = TracerProvider(
        resource=Resource.create({"service.name": "cazsl", "service.version": service.__version__})
    )
    provider.add_span_processor(BatchSpanProcessor(OTLPSpanExporter(endpoint)))
    return provider


class Tracing:
    """A ring around all others, which records a span for every request."""

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
        span = self._begin(scope)
        try:
            with use_span(span):
                await self._app(scope, receive, send)
        finally:
            _end(span, scope)

    def _begin(self, scope: Scope) -> Span:
        """Start the span of a request in the trace of its caller. A fault of the tracing costs the span only."""
        try:
            headers = scope["headers"]
            carrier = {name.decode(): value.decode("latin-1") for name, value in headers if name in _TRACE_HEADERS}
            return self._tracer.start_span(scope["method"], self._propagator.extract(carrier), SpanKind.SERVER)
        except Exception:
            logger.exception("a span could not begin")
            return INVALID_SPAN


def _end(span: Span, scope: Scope) -> None:
    """End the span of a request. A fault of the tracing costs the span only."""
    try:
        try:
            _describe(span, record_of(scope))
        finally:
            span.end()
    except Exception:
        logger.exception("a span was lost")


def _describe(span: Span, record: RequestRecord) -> None:
    span.update_name(f"{record.method} {record.route}")
    span.set_attributes({"http.request.method": record.method, "http.route": record.route})
    span.set_attributes({"http.response.status_code": record.status, "cazsl.request_id": record.request_id})
    if record.model:
        span.set_attributes({"cazsl.model": record.model, "cazsl.version": record.version})
        span.set_attribute("cazsl.pushes", record.pushes)
    if record.code:
        span.set_attribute("error.type", record.code)
    if record.status >= HTTPStatus.INTERNAL_SERVER_ERROR:
        span.set_status(Status(StatusCode.ERROR))
