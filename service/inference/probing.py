"""Probing: the self-check of every loaded version, each in a thread of its own and within a time limit.

Self-checks run together, so a slow model delays no other one. A few may begin at once, because each takes a processor.
One that hangs keeps its thread and gives its place to another model. It is not started again until it ends.
"""

import asyncio
import logging
from collections.abc import Callable, Mapping
from typing import Final

from service.background.threads import NoThreadError, PurposeThreads
from service.errors import CazslError
from service.model.loaded_model import LoadedModel
from service.model.self_check import check_itself

Key = tuple[str, int]
Settle = Callable[[Key, str | None], None]
AT_ONCE: Final = 2
PLACE_S: Final = 1.0
MAX_THREADS: Final = 64

logger = logging.getLogger(__name__)


class Probing:
    """The probes of all loaded versions. Each result is None, or the reason why the version is not ready."""

    def __init__(self, limit_s: float) -> None:
        self._limit_s = limit_s
        self._threads = PurposeThreads("probe", MAX_THREADS)
        self._running: dict[Key, asyncio.Future[float]] = {}
        self._took_s: dict[Key, float] = {}

    async def probe(self, models: Mapping[Key, LoadedModel], settle: Settle) -> None:
        """Probe these versions once. Each result is settled as soon as it is known, and is not raised."""
        self._running = {key: running for key, running in self._running.items() if not running.done()}
        self._took_s = {key: took_s for key, took_s in self._took_s.items() if key in models}
        places = asyncio.Semaphore(AT_ONCE)

        async def probe_one(key: Key) -> None:
            """Probe one version."""
            settle(key, await self._probe(key, models[key], places))

        # Models that were slow the last time come last, so they do not delay the others even for a moment.
        keys = sorted(models, key=lambda key: self._took_s.get(key, 0.0))
        await asyncio.gather(*map(probe_one, keys))

    async def _probe(self, key: Key, model: LoadedModel, places: asyncio.Semaphore) -> str | None:
        """Run one self-check, unless the last one still runs."""
        late = f"the self-check did not end within {self._limit_s:g} s"
        if key in self._running:
            return late
        loop = asyncio.get_running_loop()
        async with places:
            began = loop.time()
            try:
                running = asyncio.wrap_future(self._threads.submit(check_itself, model.manifest, model.predictor))
            except NoThreadError as error:
                return f"the self-check could not begin: {error}"
            running.add_done_callback(_retrieve)
            self._running[key] = running
            await asyncio.wait([running], timeout=min(PLACE_S, self._limit_s))
        await asyncio.wait([running], timeout=max(0.0, began + self._limit_s - loop.time()))
        self._took_s[key] = loop.time() - began
        if not running.done():
            return late
        del self._running[key]
        failure = running.exception()
        if failure is None:
            model.cost.renew(running.result())
            return None
        if isinstance(failure, CazslError):
            return str(failure)
        logger.error("probe failed", extra={"model": key[0], "version": key[1]}, exc_info=failure)
        return "the self-check failed; the log has the cause"


def _retrieve(running: asyncio.Future[float]) -> None:
    """Retrieve the error of a self-check that ends after its time. Otherwise asyncio would log it."""
    if not running.cancelled():
        running.exception()
