"""Verified models in memory: load, self-check, swap, release.

``refresh`` brings memory in line with the registry. It loads every version that an alias names, and the newest few of
each model. Each is verified (format, sizes, digests, tensors, self-check) before a request can reach it. The served
models are one immutable snapshot, which is exchanged by assigning one reference. A request keeps the model that it
started with.

If a new version fails verification, its alias keeps the previous version, and readiness names the reason. If the
registry cannot be read, the snapshot stays as it is. A version or folder that disappears without having been removed,
as when a disk is no longer mounted, stays served.
"""

import contextlib
import logging
import threading
from collections import Counter
from dataclasses import dataclass, field, replace
from typing import Final

from service.errors import CazslError
from service.inference.snapshot import Snapshot
from service.model.loaded_model import LoadedModel
from service.model.predictor import PredictorFactory
from service.registry.loading import load_version
from service.registry.registry import Registry
from service.storage.history import ModelState

# Files that are edited by hand may leave the fingerprint of the registry as it was. Every 30th poll reads all files.
THOROUGH_EVERY: Final = 30

logger = logging.getLogger(__name__)


@dataclass
class ModelCounters:
    """Counters by model name since the start, and the state of the registry at the last poll."""

    loads: Counter[str] = field(default_factory=Counter)
    releases: Counter[str] = field(default_factory=Counter)
    failures: Counter[str] = field(default_factory=Counter)
    swaps: Counter[tuple[str, str]] = field(default_factory=Counter)
    registry_failures: int = 0
    registry_up: bool = False


class LoadedModels:
    """Models of a registry in memory, as a snapshot that ``refresh`` renews."""

    def __init__(self, registry: Registry, load: PredictorFactory, newest_versions: int = 8) -> None:
        self._registry = registry
        self._load = load
        self._newest_versions = newest_versions
        self.counters = ModelCounters()
        self._snapshot = Snapshot()
        self._last_fingerprint: object = None
        self._polls = 0
        self._refreshing = threading.Lock()

    @property
    def snapshot(self) -> Snapshot:
        """Return the models that are served now. A request keeps this snapshot to its end."""
        return self._snapshot

    def refresh(self) -> None:
        """Bring memory in line with the registry. It never raises for the registry: the snapshot lists its problems."""
        with self._refreshing:
            self._polls += 1
            try:
                fingerprint = self._registry.fingerprint()
                self.counters.registry_up = True
                unchanged = fingerprint == self._last_fingerprint and not self._snapshot.problems
                if unchanged and self._polls % THOROUGH_EVERY:
                    return
                snapshot = self._next_snapshot()
                self._last_fingerprint = fingerprint
            except CazslError as error:
                self.counters.registry_up = False
                self.counters.registry_failures += 1
                snapshot = self._after_failure(str(error))
            self._announce(snapshot)
            self._snapshot = snapshot

    def _after_failure(self, problem: str) -> Snapshot:
        """Return the old snapshot with a new problem. At the start, return the versions that the storage has cached."""
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
            problems += [f"{name}@{version} has vanished without being removed and stays served" for version in lost]
            newest = sorted(state.versions)[-self._newest_versions :]
            for version in sorted({*newest, *wanted.values(), *lost}):
                try:
                    models[name, version] = self._snapshot.models.get((name, version)) or load_version(
                        self._registry, self._load, name, version
                    )
                except CazslError as error:
                    self.counters.failures[name] += 1
                    problems.append(f"{name}@{version} is broken and not served: {error}")
            for alias, version in wanted.items():
                kept = self._snapshot.aliases.get((name, alias))
                if alias not in state.aliases:
                    problems.append(f"{name}@{alias} has vanished; {version} stays served")
                if (name, version) in models:
                    aliases[name, alias] = version
                elif kept is not None and (old := self._snapshot.models.get((name, kept))) is not None:
                    models[name, kept] = old
                    aliases[name, alias] = kept
                    problems.append(f"{name}@{alias} should be {version}; {kept} stays served")
        return Snapshot(models, aliases, tuple(problems) if models or problems else ("the registry holds no model",))

    def _lost_versions(self, name: str, state: ModelState) -> set[int]:
        """Return served versions that are absent but not removed: the storage has an outage, or files were deleted."""
        served = {version for model, version in self._snapshot.models if model == name}
        return served - state.versions - state.removed

    def _lost_aliases(self, name: str, state: ModelState) -> dict[str, int]:
        """Return served aliases that are absent, though no line of the history drops them."""
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
        """Log and count each change once."""
        old, counters = self._snapshot, self.counters
        for name, version in sorted(new.models.keys() - old.models.keys()):
            counters.loads[name] += 1
            logger.info("model loaded", extra={"model": name, "version": version})
        for name, version in sorted(old.models.keys() - new.models.keys()):
            counters.releases[name] += 1
            logger.info("model released", extra={"model": name, "version": version})
        for (name, alias), version in new.aliases.items():
            if old.aliases.get((name, alias)) != version:
                counters.swaps[name, alias] += (name, alias) in old.aliases
                logger.info("alias serves", extra={"model": name, "alias": alias, "version": version})
        if new.problems != old.problems:
            for problem in new.problems:
                logger.warning("registry problem", extra={"problem": problem})
