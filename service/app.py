"""``create_app(settings, models)``: composition only."""

import asyncio
import contextlib
import logging
from collections.abc import AsyncIterator
from typing import Any

from fastapi import FastAPI
from starlette.types import Receive, Scope, Send

import service
from service.errors import CazslError
from service.loaded_models import LoadedModels
from service.problems import BodyLimit, install_problem_handlers, problem_response, state_media_type
from service.routes import router
from service.settings import Settings
from service.telemetry import RequestTelemetry

logger = logging.getLogger(__name__)

DESCRIPTION = """\
Where does an object end up when a robot pushes it, and how sure can we be? Give a pusher pose and what is known of the
object; get a Gaussian over the object's pose after a straight push of 50 mm.

Units are SI: metres, radians. The frame is the object's pose before the push: origin at the centre of its core, x axis
through the middle of side 1, y axis through the middle of side 2, counter-clockwise positive.
"""


class Service(FastAPI):
    """The application; its OpenAPI document tells the truth about failures."""

    def openapi(self) -> dict[str, Any]:
        """The document, made once."""
        return state_media_type(super().openapi())


def create_app(settings: Settings, models: LoadedModels) -> FastAPI:
    """The service over these models."""

    @contextlib.asynccontextmanager
    async def lifespan(_: FastAPI) -> AsyncIterator[None]:
        """Look at the registry before the first request and from then on."""
        await asyncio.to_thread(models.refresh)
        poll = asyncio.create_task(_poll(models, settings.poll_interval_s))
        yield
        poll.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await poll

    app = Service(
        title="CAZSL",
        version=service.__version__,
        description=DESCRIPTION,
        lifespan=lifespan,
        redirect_slashes=False,  # a redirect would name the host that the request claimed
    )
    app.state.settings = settings
    app.state.models = models
    app.include_router(router)
    install_problem_handlers(app)
    app.add_middleware(BodyLimit, max_body_size=settings.max_body_bytes)
    app.add_middleware(RequestTelemetry, internal_error=_internal_error)
    return app


async def _poll(models: LoadedModels, interval_s: float) -> None:
    """Look for new versions and moved aliases, for as long as the app lives."""
    while True:
        await asyncio.sleep(interval_s)
        try:
            await asyncio.to_thread(models.refresh)
        except Exception:  # the outermost ring of this task: a bug here must not end the looking, unseen
            logger.exception("refresh failed")


async def _internal_error(scope: Scope, receive: Receive, send: Send) -> None:
    error = CazslError("the request could not be answered; the log has the cause under this request_id")
    await problem_response(scope, error)(scope, receive, send)
