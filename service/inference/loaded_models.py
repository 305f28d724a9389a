"""Verified predictors in memory: load, self-check, swap, release, readiness.

``refresh`` brings memory in line with the registry: every version that an alias names and the newest few of each model
are loaded, each verified in the written order (format, sizes, digests, tensors, self-check) before anyone can reach
it. What is served is one immutable snapshot, exchanged by assigning one reference: a request keeps the model that it
started with. A new version that is broken changes nothing: its alias goes on meaning what it meant, and readiness
says why. A registry that cannot be read changes nothing either, and what is gone without having been removed, be it a
whole folder that is no longer mounted, goes on being served.
"""

import contextlib
import logging
import threading
from dataclasses import replace
from typing import Final

from service.errors import (
    CazslError,
)
from service.inference.counters import Tally
from service.inference.snapshot import Snapshot
from service.model.loaded_model import LoadedModel, PredictorFactory
from service.model.tensors import ContextKind
from service.pushing.contexts import ObjectContext, VisualContext
from service.registry.loading import load_version
from service.registry.registry import Registry
from service.storage.history import ModelState

# Files that hands or other tools moved need not show in a fingerprint: every so many looks, one looks at everything.
THOROUGH_EVERY: Final = 30

logger = logging.getLogger(__name__)


def context_kind_of(context: ObjectContext | VisualContext | None) -> ContextKind:
    """The kind of context that was given."""
    return ContextKind.NONE if context is None else context.kind


class LoadedModels:
    """Keeps a snapshot in line with a registry."""

    def __init__(self, registry: Registry, load: PredictorFactory, newest_versions: int = 8) -> None:
        self._registry = registry
        self._load = load
        self._newest_versions = newest_versions
        self.tally = Tally()
        self._snapshot = Snapshot()
        self._seen: object = None
        self._looks = 0
        self._refreshing = threading.Lock()

    @property
    def snapshot(self) -> Snapshot:
        """What is served now; hold on to it for the length of a request."""
        return self._snapshot

    def refresh(self) -> None:
        """Bring memory in line with the registry; never raises for what is found there."""
        with self._refreshing:
            self._looks += 1
            try:
                seen = self._registry.fingerprint()
                self.tally.registry_up = True
                if seen == self._seen and not self._snapshot.problems and self._looks % THOROUGH_EVERY:
                    return
                snapshot = self._next_snapshot()
                self._seen = seen
            except CazslError as error:
                self.tally.registry_up = False
                self.tally.registry_failures += 1
                snapshot = self._without_news(str(error))
            self._announce(snapshot)
            self._snapshot = snapshot

    def _without_news(self, problem: str) -> Snapshot:
        """What goes on being served; where nothing is yet, what the storage remembers although it cannot be asked."""
        if not self._snapshot.models:
            with contextlib.suppress(CazslError):
                remembered = self._next_snapshot()
                if remembered.models:
                    return replace(remembered, problems=(problem, *remembered.problems))
        return replace(self._snapshot, problems=(problem,))

    def _next_snapshot(self) -> Snapshot:
        models: dict[tuple[str, int], LoadedModel] = {}
        aliases: dict[tuple[str, str], int] = {}
        problems: list[str] = []
        for name in sorted({*self._registry.names(), *(name for name, _ in self._snapshot.models)}):
            state = self._registry.state(name)
            lost = self._lost_versions(name, state)
            wanted = self._lost_aliases(name, state) | dict(state.aliases)
            problems += [
                f"{name}@{version} has vanished without being removed and goes on being served" for version in lost
            ]
            newest = sorted(state.versions)[-self._newest_versions :]
            for version in sorted({*newest, *wanted.values(), *lost}):
                try:
                    models[name, version] = self._snapshot.models.get((name, version)) or load_version(
                        self._registry, self._load, name, version
                    )
                except CazslError as error:
                    self.tally.failures[name] += 1
                    problems.append(f"{name}@{version} is broken and not served: {error}")
            for alias, version in wanted.items():
                kept = self._snapshot.aliases.get((name, alias))
                if alias not in state.aliases:
                    problems.append(f"{name}@{alias} has vanished; {version} goes on being served")
                if (name, version) in models:
                    aliases[name, alias] = version
                elif kept is not None and (old := self._snapshot.models.get((name, kept))) is not None:
                    models[name, kept] = old
                    aliases[name, alias] = kept
                    problems.append(f"{name}@{alias} should be {version}; {kept} goes on being served")
        return Snapshot(models, aliases, tuple(problems) if models or problems else ("the registry holds no model",))

    def _lost_versions(self, name: str, state: ModelState) -> set[int]:
        """Versions that are served and neither there nor removed: the storage blinked, or a hand deleted them."""
        served = {version for model, version in self._snapshot.models if model == name}
        return served - state.versions - state.removed

    def _lost_aliases(self, name: str, state: ModelState) -> dict[str, int]:
        """Aliases that are served and no longer there, though no line of the history tells that they were dropped."""
        missing = {
            alias: version
            for (model, alias), version in self._snapshot.aliases.items()
            if model == name and alias not in state.aliases
        }
        if not missing:
            return {}
        with contextlib.suppress(CazslError):
            recorded = self._registry.history(name).state().aliases
            return {alias: version for alias, version in missing.items() if alias in recorded}
        return missing

    def _announce(self, new: Snapshot) -> None:
        """Log and count what changed, once."""
        old, tally = self._snapshot, self.tally
        for name, version in sorted(new.models.keys() - old.models.keys()):
            tally.loads[name] += 1
            logger.info("model loaded", extra={"model": name, "version": version})
        for name, version in sorted(old.models.keys() - new.models.keys()):
            tally.releases[name] += 1
            logger.info("model released", extra={"model": name, "version": version})
        for (name, alias), version in new.aliases.items():
            if old.aliases.get((name, alias)) != version:
                tally.swaps[name, alias] += (name, alias) in old.aliases
                logger.info("alias serves", extra={"model": name, "alias": alias, "version": version})
        if new.problems != old.problems:
            for problem in new.problems:
                logger.warning("registry problem", extra={"problem": problem})
