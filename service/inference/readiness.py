"""Whether predictions can be answered, said truthfully: loaded, checked, and a tiny inference that was right just now.

A model that is loaded passed its self-check. On a timer every one of them is asked for its self-check again, in a
thread, each within a limit: a model that fails, gives something else or does not end is not ready, and comes back by
itself once it answers. A registry that cannot be read makes nothing unready that is served.
"""

import asyncio
import logging
from collections import Counter
from dataclasses import dataclass
from typing import Final

from service.errors import CazslError
from service.inference.loaded_models import LoadedModels
from service.model.loaded_model import LoadedModel
from service.model.self_check import check_itself

Key = tuple[str, int]
DRAINING: Final = "SIGTERM has come: what is running is finished, nothing new should be sent here"

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class ModelCheck:
    """One version that is loaded, and why it cannot be asked where it cannot."""

    name: str
    version: int
    reason: str | None

    @property
    def ready(self) -> bool:
        """Whether its last inference was right."""
        return self.reason is None


class Readiness:
    """What the probes found."""

    def __init__(self, models: LoadedModels, poll_interval_s: float, limit_s: float) -> None:
        self._models = models
        self._poll_interval_s = poll_interval_s
        self._limit_s = limit_s
        self._reasons: dict[Key, str] = {}
        self._running: dict[Key, asyncio.Future[None]] = {}
        self.failures: Counter[str] = Counter()
        self.draining = False

    def drain(self) -> None:
        """The end has come: nothing new should be sent here."""
        self.draining = True

    def checks(self) -> list[ModelCheck]:
        """Every version that is loaded, by name and number; a newcomer passed its self-check while it was loaded."""
        reasons = self._reasons
        return [ModelCheck(*key, reasons.get(key)) for key in sorted(self._models.snapshot.models)]

    def reason_against(self, name: str, version: int) -> str | None:
        """Why this version cannot be asked now; None when it can."""
        return self._reasons.get((name, version))

    def is_ready(self) -> bool:
        """Whether to send requests here: a model can be asked, and the end has not come."""
        return not self.draining and any(check.ready for check in self.checks())

    def reason(self) -> str | None:
        """Why not, and what is being done about it; None when ready."""
        if self.draining:
            return DRAINING
        if self.is_ready():
            return None
        checks, problems = self.checks(), self._models.snapshot.problems
        cause = f"{checks[0].name}@{checks[0].version}: {checks[0].reason}" if checks else "; ".join(problems)
        return f"not ready, looking again every {self._poll_interval_s:g} s, because {cause or 'no model is loaded'}"

    async def probe(self) -> None:
        """Ask every loaded version for its self-check once; never raises for what is found."""
        models = self._models.snapshot.models
        found = {key: await self._probe(key, model) for key, model in models.items()}
        for key, reason in found.items():
            if reason is not None:
                self.failures[key[0]] += 1
            if reason != self._reasons.get(key):
                extra = {"model": key[0], "version": key[1], "reason": reason}
                logger.warning("model cannot be asked" if reason else "model can be asked again", extra=extra)
        self._reasons = {key: reason for key, reason in found.items() if reason is not None}

    async def _probe(self, key: Key, model: LoadedModel) -> str | None:
        """One tiny inference; one that did not end is waited for rather than asked again."""
        running = self._running.pop(key, None)
        if running is None:
            running = asyncio.ensure_future(asyncio.to_thread(check_itself, model.manifest, model.predictor))
        try:
            await asyncio.wait_for(asyncio.shield(running), self._limit_s)
        except TimeoutError:
            self._running[key] = running
            return f"a tiny inference did not end within {self._limit_s:g} s"
        except CazslError as error:
            return str(error)
        except Exception:  # the outermost ring of the probe: what nobody foresaw is a reason too, and ends no timer
            logger.exception("probe failed", extra={"model": key[0], "version": key[1]})
            return "a tiny inference failed; the log has the cause"
        return None
