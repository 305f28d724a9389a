"""Readiness: a model is ready if it is loaded, passed its checks, and its last probe was right.

A timer probes every loaded model again (``probing``). A model that fails, gives another output or does not end is not
ready, and becomes ready again once it answers. A registry that cannot be read does not change the readiness of a model.

The service is ready while the default models answer, see ``Readiness.reason``.
"""

import logging
from collections import Counter
from dataclasses import dataclass
from typing import Final

from service.inference.loaded_models import LoadedModels
from service.inference.probing import Key, Probing
from service.model.reference import DEFAULT_ALIAS

DRAINING: Final = "SIGTERM was received: running requests are finished; send new ones to another instance"

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class ModelCheck:
    """Result of the last probe of a loaded version: the reason of its failure, or None."""

    name: str
    version: int
    reason: str | None

    @property
    def ready(self) -> bool:
        """Return whether the last probe was right."""
        return self.reason is None


class Readiness:
    """Readiness of all loaded versions, by their probes."""

    def __init__(self, models: LoadedModels, poll_interval_s: float, limit_s: float) -> None:
        self._models = models
        self._poll_interval_s = poll_interval_s
        self._reasons: dict[Key, str] = {}
        self._probing = Probing(limit_s)
        self.failures: Counter[str] = Counter()
        self.draining = False

    def drain(self) -> None:
        """Stop being ready: the service is about to end."""
        self.draining = True

    def checks(self) -> list[ModelCheck]:
        """Return the result for every loaded version, by name and number. A version that is new passed at loading."""
        reasons = self._reasons
        return [ModelCheck(*key, reasons.get(key)) for key in sorted(self._models.snapshot.models)]

    def reason_against(self, name: str, version: int) -> str | None:
        """Return why this version is not ready, or None if it is."""
        return self._reasons.get((name, version))

    def is_ready(self) -> bool:
        """Return whether the default models answer and the service is not about to end. See ``reason``."""
        return not self.draining and self._cause() is None

    def reason(self) -> str | None:
        """Return why the service is not ready and when it polls again, or None if it is ready.

        At least one default model has to answer: its champion is loaded and its last probe was right. So does every
        other default model that has a champion by its record. One that never had a champion, or whose champion was
        dropped, is not waited for.
        """
        if self.draining:
            return DRAINING
        cause = self._cause()
        return None if cause is None else f"not ready, looking again every {self._poll_interval_s:g} s, because {cause}"

    def _cause(self) -> str | None:
        snapshot, answering = self._models.snapshot, False
        if not snapshot.models:
            return "; ".join(snapshot.problems) or "no model is loaded"
        for name in dict.fromkeys(snapshot.defaults.values()):
            version = snapshot.aliases.get((name, DEFAULT_ALIAS))
            if version is not None and (reason := self._reasons.get((name, version))) is not None:
                return f"{name}@{version}: {reason}"
            if version is None and (reason := snapshot.silent.get(name)) is not None:
                return f"{name}@{DEFAULT_ALIAS} does not answer: {reason}"
            answering |= version is not None
        return None if answering else f"no default model has a champion ({', '.join(snapshot.defaults.values())})"

    async def probe(self) -> None:
        """Run the self-check of every loaded version once. A failure makes a version not ready, and is not raised."""
        models = self._models.snapshot.models
        await self._probing.probe(models, self._settle)
        self._reasons = {key: reason for key, reason in self._reasons.items() if key in models}

    def _settle(self, key: Key, reason: str | None) -> None:
        """Note the result of a probe, and log a change."""
        if reason is not None:
            self.failures[key[0]] += 1
        if reason == self._reasons.get(key):
            return
        extra = {"model": key[0], "version": key[1], "reason": reason}
        logger.warning("model is not ready" if reason else "model is ready again", extra=extra)
        others = {other: known for other, known in self._reasons.items() if other != key}
        self._reasons = others if reason is None else others | {key: reason}
