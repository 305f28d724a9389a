"""Scrapes of the metrics: the text is made in a thread, because thousands of series take long.

``Scrapes`` is also the application of a separate port, which has one route and needs no key.
"""

import asyncio
from typing import Final

from prometheus_client import CollectorRegistry
from starlette.responses import Response
from starlette.types import Receive, Scope, Send

from service.background.threads import PurposeThreads
from service.errors import CazslError, DeadlineError
from service.observability.prometheus import CONTENT_TYPE, render
from service.observability.records import record_of
from service.transport.problems import problem_response, render_problem

PATH: Final = "/metrics"
LIMIT_S: Final = 10.0  # Prometheus itself waits no longer by default


class Scrapes:
    """Scrapes of one registry of metrics. Those at the same time share one text, so there is one thread at most."""

    def __init__(self, registry: CollectorRegistry) -> None:
        self._registry = registry
        self._threads = PurposeThreads("scrape", 1)
        self._running: asyncio.Future[bytes] | None = None

    async def text(self) -> bytes:
        """Return the text of a scrape.

        Raises:
            DeadlineError: it was not ready in time.
        """
        running = self._running
        if running is None or running.done():
            running = self._running = asyncio.wrap_future(self._threads.submit(render, self._registry))
        done, _ = await asyncio.wait([running], timeout=LIMIT_S)
        if not done:
            raise DeadlineError(LIMIT_S)
        return running.result()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request on a port that has only metrics."""
        if scope["path"] != PATH:
            await render_problem(scope, 404, "no_such_route", "No such route", f"this port has {PATH} only")(
                scope, receive, send
            )
            return
        record_of(scope).route = PATH
        if scope["method"] not in ("GET", "HEAD"):
            headers = {"Allow": "GET, HEAD"}
            response = render_problem(
                scope, 405, "method_not_allowed", "Method not allowed", f"{PATH} has GET only", headers=headers
            )
        else:
            try:
                response = Response(await self.text(), media_type=CONTENT_TYPE)
            except CazslError as error:
                response = problem_response(scope, error)
        await response(scope, receive, send)
