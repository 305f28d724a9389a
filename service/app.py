"""Application: ``create_app(settings, models)`` composes all parts."""

import contextlib
from collections.abc import AsyncIterator, Callable
from contextlib import AbstractAsyncContextManager
from dataclasses import replace
from typing import Any, Final

from fastapi import Depends, FastAPI
from starlette.middleware.errors import ServerErrorMiddleware
from starlette.types import ASGIApp, Receive, Scope, Send

import service
from service.api import health
from service.api.dependencies import Parts, may_predict
from service.api.docs_page import docs_router
from service.api.error_handlers import install_error_handlers
from service.api.gauges import gauges
from service.api.open_inference import routes as open_inference
from service.api.open_inference.bodies import ErrorBody
from service.api.open_inference.endpoints import inference_endpoints
from service.api.openapi import give_examples, problems, protocol_errors, state_media_type
from service.api.path_prefix import PathPrefix, servers
from service.api.planning.endpoints import PLANNING_ENDPOINTS
from service.api.planning.routes import planning
from service.api.scrapes import Scrapes
from service.api.v1 import routes as v1
from service.api.v1.endpoints import ENDPOINTS, SINGLE
from service.background.supervision import Supervisor
from service.background.threads import PurposeThreads
from service.connections.connection import BoundedConnection
from service.connections.listener import ConnectionLimits, Listener
from service.connections.shortcut_connection import connection_class
from service.errors import ForbiddenError, MissingKeyError
from service.inference.loaded_models import LoadedModels
from service.inference.readiness import Readiness
from service.observability.logs import RequestLog
from service.observability.metrics import RequestMetrics
from service.observability.prometheus import exposition
from service.observability.telemetry import RequestTelemetry
from service.schemas.problems import ProblemBody
from service.settings import Settings
from service.transport.admission import Admission, AdmissionLimits
from service.transport.callers import Callers
from service.transport.endpoints import Endpoints
from service.transport.fast_path import FastPath, Shortcut
from service.transport.keys import READ_INTERVAL_S, Keys
from service.transport.problems import problem_response
from service.transport.threads import ThreadPool, threads_beside_the_loop

_FIRST_POLL_S: Final = 2.0
_METRICS_CONNECTIONS: Final = 32

DESCRIPTION = """\
Predicts the pose of an object after a robot pushes it, and the uncertainty of that pose. Send the pose of the pusher
and a context of the object. The answer is a Gaussian over the pose of the object after a straight push of 50 mm.

Units are SI: metres and radians. The frame is the pose of the object before the push: origin at the centre of its core,
x axis through the middle of side 1, y axis through the middle of side 2, counter-clockwise positive.
"""


class Service(FastAPI):
    """The application: FastAPI inside, and our rings around it.

    The rings are outside of FastAPI instead of among its middleware. A request that they answer costs no time there.

    Attributes:
        parts: parts of the application that routes use.
        rings: the outermost ring.
        requests: metrics of requests, and of refusals that happen before there is a request.
        shortcut: answers single pushes for connections. None if every request must pass all rings.
        connections: class of connections, which the server instantiates.
        metrics: the application of a separate port for metrics.
        metrics_connections: class of connections of that port, with a limit of their own.
    """

    parts: Parts
    rings: ASGIApp
    requests: RequestMetrics
    shortcut: Shortcut | None = None
    connections: type[BoundedConnection]
    metrics: ASGIApp
    metrics_connections: type[BoundedConnection]

    def build_middleware_stack(self) -> ASGIApp:
        """Return the framework without its outermost ring, whose answer to an unexpected exception is plain text."""
        stack = super().build_middleware_stack()
        return stack.app if isinstance(stack, ServerErrorMiddleware) else stack

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one request, from the outermost ring inwards."""
        await self.rings(scope, receive, send)

    async def framework(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one request inside of the rings."""
        if scope["type"] != "http" or scope["method"] != "HEAD":
            await super().__call__(scope, receive, send)
            return
        asked = {**scope, "method": "GET"}  # the connection leaves out the body
        try:
            await super().__call__(asked, receive, send)
        finally:
            scope["route"] = asked.get("route")

    def openapi(self) -> dict[str, Any]:
        """Return the OpenAPI document, which is made once."""
        if self.openapi_schema is None:
            made = give_examples(open_inference.describe_infer(state_media_type(super().openapi())))
            self.openapi_schema = made
        return self.openapi_schema


def create_app(
    settings: Settings,
    models: LoadedModels,
    log: RequestLog | None = None,
    trace: Callable[[ASGIApp], ASGIApp] = lambda app: app,
) -> Service:
    """Compose the service over these models.

    Args:
        settings: settings of the operator.
        models: models to serve. The application polls their registry.
        log: log of requests. None: standard error.
        trace: puts a ring around all others, such as ``tracing.Tracing``.
    """
    log = log or RequestLog()
    threads = ThreadPool(
        threads_beside_the_loop(), settings.max_waiting, settings.deadline_s, settings.max_working_bytes
    )
    keys = Keys(settings.keys)
    readiness = Readiness(models, settings.poll_interval_s, settings.deadline_s)
    supervisor = _supervisor(settings, models, readiness, keys, log)
    endpoints = Endpoints(
        (*ENDPOINTS, *PLANNING_ENDPOINTS, *inference_endpoints(settings.max_body_bytes)), models, threads
    )
    app = Service(
        title="CAZSL",
        version=service.__version__,
        description=DESCRIPTION,
        lifespan=_lifespan(supervisor, threads, log),
        docs_url=None,  # our page loads no file from another host
        redoc_url=None,
        servers=servers(settings.root_path),
        redirect_slashes=False,  # a redirect would repeat the host in the request
    )
    admission = Admission(FastPath(app.framework, endpoints), _limits(settings), Callers(keys), endpoints.turns)
    app.requests = RequestMetrics(lambda name, version: (name, version) in models.snapshot.models)
    telemetry = RequestTelemetry(admission, problem_response, log, app.requests)

    def refuse(code: str) -> str:
        """Count a refusal that happens before there is a request. Return the id of its answer."""
        app.requests.refuse(code)
        return telemetry.new_id()

    limits = _connection_limits(settings)
    listener = Listener(limits, admission.held, refuse)
    metrics = exposition(
        app.requests, gauges(models, readiness, threads, admission, listener, keys, supervisor, log.writer.dropped)
    )
    app.parts = Parts(models, readiness, supervisor, keys, endpoints, metrics, Scrapes(metrics))
    _include_routes(app, keys.wanted, metrics=settings.metrics_port is None)
    install_error_handlers(app)
    traced = trace(telemetry)
    app.rings = PathPrefix(traced, settings.root_path) if settings.root_path else traced
    if traced is telemetry:  # a ring around all others must see every request
        app.shortcut = Shortcut(SINGLE, endpoints, admission, telemetry)
    app.connections = connection_class(listener, app.shortcut)
    scraped = Admission(app.parts.scrapes, _limits(settings), Callers(Keys(None)))
    app.metrics = RequestTelemetry(scraped, problem_response, log, app.requests)
    few = replace(limits, connections=_METRICS_CONNECTIONS)
    app.metrics_connections = connection_class(Listener(few, scraped.held, refuse))
    return app


def _supervisor(
    settings: Settings, models: LoadedModels, readiness: Readiness, keys: Keys, log: RequestLog
) -> Supervisor:
    """Return the supervisor of every background task of the application."""
    polling, reading = PurposeThreads("poll", 1), PurposeThreads("keys", 1)
    supervisor = Supervisor()
    supervisor.repeat("poll", lambda: polling.run(models.refresh), settings.poll_interval_s)
    supervisor.repeat("probe", readiness.probe, settings.probe_interval_s, settings.probe_interval_s)
    if keys.wanted:
        supervisor.repeat("keys", lambda: reading.run(keys.reread), READ_INTERVAL_S, READ_INTERVAL_S)
    supervisor.watch(log.writer.health)
    return supervisor


def _lifespan(
    supervisor: Supervisor, threads: ThreadPool, log: RequestLog
) -> Callable[[FastAPI], AbstractAsyncContextManager[None]]:
    @contextlib.asynccontextmanager
    async def lifespan(_: FastAPI) -> AsyncIterator[None]:
        """Run the background tasks. The first requests await the first poll of the registry, unless it takes long."""
        async with supervisor.running():
            await supervisor.first("poll", _FIRST_POLL_S)  # a slow registry: /livez answers, /readyz gives the reason
            yield
        threads.close()
        log.close()

    return lifespan


def _include_routes(app: FastAPI, guarded: bool, metrics: bool) -> None:
    """Include every route. Those that predict or describe models require a key if the operator wants keys."""
    guard = [Depends(may_predict)] if guarded else []
    refusals = (MissingKeyError, ForbiddenError) if guarded else ()
    app.include_router(docs_router(app.title))
    app.include_router(health.router)
    for router in (v1.predictions, planning, v1.models):
        app.include_router(router, dependencies=guard, responses=problems(ProblemBody, *refusals))
    app.include_router(open_inference.health)
    if metrics:
        app.include_router(health.metrics_router)
    for router in (open_inference.router, open_inference.inference):
        app.include_router(router, dependencies=guard, responses=protocol_errors(ErrorBody, *refusals))


def _limits(settings: Settings) -> AdmissionLimits:
    return AdmissionLimits(
        body_bytes=settings.max_body_bytes,
        body_s=settings.body_timeout_s,
        in_flight=settings.max_in_flight,
        in_flight_per_caller=settings.max_in_flight_per_caller,
        held_bytes=settings.max_held_bytes,
    )


def _connection_limits(settings: Settings) -> ConnectionLimits:
    return ConnectionLimits(
        head_s=settings.body_timeout_s,
        idle_s=settings.keep_alive_s,
        write_s=settings.answer_timeout_s,
        connections=settings.max_connections,
        unsent_bytes=settings.max_unsent_bytes,
    )
