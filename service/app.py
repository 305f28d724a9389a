"""``create_app(settings, models)``: composition only."""

import asyncio
import contextlib
import gc
import logging
from collections.abc import AsyncIterator, Callable
from contextlib import AbstractAsyncContextManager
from typing import Any, Final

from fastapi import Depends, FastAPI
from starlette.types import ASGIApp, Receive, Scope, Send

import service
from service.api import health, monitoring
from service.api.dependencies import may_predict
from service.api.docs_page import documentation
from service.api.error_handlers import install_problem_handlers
from service.api.gauges import vitals
from service.api.open_inference import routes as open_inference
from service.api.open_inference.bodies import ErrorBody
from service.api.openapi import give_examples, problems, protocol_errors, state_media_type
from service.api.v1 import routes
from service.errors import CazslError, ForbiddenError, MissingKeyError
from service.inference.loaded_models import LoadedModels
from service.inference.readiness import Readiness
from service.observability.logs import RequestLog
from service.observability.metrics import RequestMetrics
from service.observability.prometheus import exposition
from service.observability.telemetry import RequestTelemetry
from service.schemas.problems import ProblemBody
from service.settings import Settings
from service.transport.admission import Intake, IntakeLimits
from service.transport.fast_path import FastPath
from service.transport.keys import Keys
from service.transport.problems import problem_response
from service.transport.short_way import ShortWay
from service.transport.threads import Workers, threads_beside_the_loop

_FIRST_LOOK_S: Final = 2.0

logger = logging.getLogger(__name__)

DESCRIPTION = """\
Where does an object end up when a robot pushes it, and how sure can we be? Give a pusher pose and what is known of the
object; get a Gaussian over the object's pose after a straight push of 50 mm.

Units are SI: metres, radians. The frame is the object's pose before the push: origin at the centre of its core, x axis
through the middle of side 1, y axis through the middle of side 2, counter-clockwise positive.
"""


class Service(FastAPI):
    """The application: FastAPI inside, our rings around it; its OpenAPI document tells the truth about failures.

    The rings stand outside of FastAPI, not among its middleware: what they answer costs none of its machinery.
    """

    rings: ASGIApp

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one request, from the outermost ring inwards."""
        await self.rings(scope, receive, send)

    async def framework(self, scope: Scope, receive: Receive, send: Send) -> None:
        """What is inside of the rings."""
        await super().__call__(scope, receive, send)

    def openapi(self) -> dict[str, Any]:
        """The document, made once."""
        return give_examples(open_inference.describe_infer(state_media_type(super().openapi())))


def create_app(
    settings: Settings,
    models: LoadedModels,
    log: RequestLog | None = None,
    trace: Callable[[ASGIApp], ASGIApp] = lambda app: app,
) -> FastAPI:
    """The service over these models; the lines of requests go to standard error unless told otherwise.

    ``trace`` puts a ring around all others, as ``tracing.Tracing`` is one.
    """
    log = log or RequestLog()
    workers = Workers(threads_beside_the_loop(), settings.max_waiting, settings.deadline_s)
    keys = Keys(settings.keys)
    readiness = Readiness(models, settings.poll_interval_s, settings.deadline_s)

    app = Service(
        title="CAZSL",
        version=service.__version__,
        description=DESCRIPTION,
        lifespan=_lifespan(settings, models, readiness, workers, log),
        docs_url=None,  # ours asks no other host
        redoc_url=None,
        redirect_slashes=False,  # a redirect would name the host that the request claimed
    )
    app.state.models = models
    app.state.max_body_bytes = settings.max_body_bytes
    app.state.workers = workers
    app.state.keys = keys
    app.state.readiness = readiness
    app.state.short_way = None
    _include_routes(app, keys.wanted, metrics=settings.metrics_port is None)
    install_problem_handlers(app)
    fast_path = FastPath(app.framework, models, workers, keys)
    intake = Intake(fast_path, _limits(settings))
    requests = RequestMetrics(lambda name, version: (name, version) in models.snapshot.models)
    app.state.requests = requests
    app.state.metrics = exposition(requests, vitals(models, readiness, workers, intake))
    telemetry = RequestTelemetry(intake, _internal_error, log, requests)
    app.rings = trace(telemetry)
    if app.rings is telemetry:  # whoever puts a ring around all requests has them all pass it
        app.state.short_way = ShortWay(fast_path, intake, telemetry)
    return app


def _lifespan(
    settings: Settings, models: LoadedModels, readiness: Readiness, workers: Workers, log: RequestLog
) -> Callable[[FastAPI], AbstractAsyncContextManager[None]]:
    @contextlib.asynccontextmanager
    async def lifespan(_: FastAPI) -> AsyncIterator[None]:
        """Look at the registry before the first request, unless that takes long, and from then on."""
        looked = asyncio.Event()
        timers = [
            asyncio.create_task(_poll(models, settings.poll_interval_s, looked)),
            asyncio.create_task(_probe(readiness, settings.probe_interval_s)),
        ]
        with contextlib.suppress(TimeoutError):  # a slow registry: /livez answers meanwhile, /readyz says so
            await asyncio.wait_for(looked.wait(), _FIRST_LOOK_S)
        yield
        for timer in timers:
            timer.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await timer
        gc.unfreeze()
        workers.close()
        log.flush()

    return lifespan


def _include_routes(app: FastAPI, guarded: bool, metrics: bool) -> None:
    """Every route, those that predict or tell of models behind a key where keys are wanted."""
    guard = [Depends(may_predict)] if guarded else []
    refusals = (MissingKeyError, ForbiddenError) if guarded else ()
    app.include_router(documentation(app.title))
    app.include_router(health.router)
    app.include_router(routes.router, dependencies=guard, responses=problems(ProblemBody, *refusals))
    app.include_router(routes.uploads, dependencies=guard, responses=problems(ProblemBody, *refusals))
    app.include_router(open_inference.health)
    if metrics:
        app.include_router(monitoring.router)
    app.include_router(open_inference.router, dependencies=guard, responses=protocol_errors(ErrorBody, *refusals))


def _limits(settings: Settings) -> IntakeLimits:
    return IntakeLimits(
        body_bytes=settings.max_body_bytes,
        body_s=settings.body_timeout_s,
        in_flight=settings.max_in_flight,
        in_flight_per_caller=settings.max_in_flight_per_caller,
        held_bytes=settings.max_held_bytes,
    )


async def _poll(models: LoadedModels, interval_s: float, looked: asyncio.Event) -> None:
    """Look for new versions and moved aliases, now and for as long as the app lives: from look to look so many s."""
    loop = asyncio.get_running_loop()
    while True:
        began = loop.time()
        try:
            await asyncio.to_thread(models.refresh)
        except Exception:  # the outermost ring of this task: a bug here must not end the looking, unseen
            logger.exception("refresh failed")
        if not looked.is_set():
            gc.collect()
            gc.freeze()  # what is here now stays: walking it again and again cost 5 us a push, and a pause now and then
            looked.set()
        await asyncio.sleep(max(0.0, began + interval_s - loop.time()))


async def _probe(readiness: Readiness, interval_s: float) -> None:
    """Ask every model for its self-check, for as long as the app lives."""
    while True:
        await asyncio.sleep(interval_s)
        try:
            await readiness.probe()
        except Exception:  # as above
            logger.exception("probe failed")


async def _internal_error(scope: Scope, receive: Receive, send: Send) -> None:
    error = CazslError("the request could not be answered; the log has the cause under this request_id")
    await problem_response(scope, error)(scope, receive, send)
