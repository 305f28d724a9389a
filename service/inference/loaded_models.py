"""Verified models in memory: load, self-check, swap, release.

``refresh`` brings memory in line with the registry. It loads every version that an alias names, and the newest few of
each model. Each is verified (format, sizes, digests, tensors, self-check) before a request can reach it. The served
models are one immutable snapshot, which is exchanged by assigning one reference. A request keeps the model that it
started with.

If a new version fails verification, its alias keeps the previous version, and readiness names the reason. If the
registry cannot be read, the snapshot stays as it is. If one model, alias or version cannot be read, that one stays as
it is, and all others are followed. Only a recorded removal unloads: a version, alias or folder that disappears without
one, as when a disk is no longer mounted, stays served, and its absence is a problem.
"""

import contextlib
import logging
import threading
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Final

from service.errors import BrokenModelError, CazslError, UnknownModelError
from service.inference.snapshot import DEFAULT_MODELS, Snapshot
from service.model.loaded_model import LoadedModel
from service.model.predictor import PredictorFactory
from service.model.reference import DEFAULT_ALIAS
from service.registry.loading import load_version
from service.registry.registry import Registry
from service.storage.history import History, ModelState

# Files that are edited by hand may leave the fingerprint of the registry as it was. Every 30th poll reads all files.
THOROUGH_EVERY: Final = 30
MAX_STRANGERS: Final = 10  # entries in a model's place that are listed one by one

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class ServedModel:
    """Versions and aliases of one model that are served, its problems, and whether it has a champion by its record."""

    versions: dict[int, LoadedModel]
    aliases: dict[str, int]
    problems: list[str] = field(default_factory=list)
    champion_is_recorded: bool = False


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

    def __init__(
        self,
        registry: Registry,
        load: PredictorFactory,
        newest_versions: int = 8,
        defaults: Mapping[str, str] = DEFAULT_MODELS,
    ) -> None:
        self._registry = registry
        self._load = load
        self._newest_versions = newest_versions
        self.counters = ModelCounters()
        self._snapshot = Snapshot(defaults=defaults)
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
        silent: dict[str, str] = {}
        counts: Counter[str] = Counter()
        strangers = [entry for entry in self._registry.strangers() if entry.severe]
        problems += [f"{entry.where} {entry.wrong}" for entry in strangers[:MAX_STRANGERS]]
        counts.update(entry.where for entry in strangers[:MAX_STRANGERS])
        if len(strangers) > MAX_STRANGERS:
            problems.append(f"{len(strangers) - MAX_STRANGERS} more entries are in a model's place and are none")
        for name in sorted({*self._registry.names(), *self._snapshot.names()}):
            found = self._follow(name)
            models |= {(name, version): model for version, model in found.versions.items()}
            aliases |= {(name, alias): version for alias, version in found.aliases.items()}
            problems += found.problems
            counts[name] += len(found.problems)
            if found.champion_is_recorded and DEFAULT_ALIAS not in found.aliases:
                silent[name] = found.problems[0] if found.problems else "no version is named by its champion"
        if not models and not problems:
            problems.append("the registry holds no model")
        return Snapshot(models, aliases, tuple(problems), silent, counts, self._snapshot.defaults)

    def _follow(self, name: str) -> ServedModel:
        """Return the versions and aliases of a model to serve now. A fault of any kind stays with this model."""
        served = ServedModel(
            {version: model for (other, version), model in self._snapshot.models.items() if other == name},
            self._snapshot.aliases_of(name),
        )
        try:
            return self._next_of(name, served)
        except CazslError as error:
            problem = str(error)
        except Exception:  # a bug that one model meets must not stop the others
            logger.exception("model cannot be followed", extra={"model": name})
            problem = "it cannot be followed; the log has the cause"
        problem = f"{name}: {problem.removeprefix(f'{name}: ')}" + (
            "; its versions stay served" if served.versions else ""
        )
        return replace(served, problems=[problem], champion_is_recorded=True)

    def _next_of(self, name: str, served: ServedModel) -> ServedModel:
        """Return the state of the registry as far as it loads. What is only absent stays served."""
        state, record, unreadable = self._registry.state(name), History(), ""
        if DEFAULT_ALIAS not in state.aliases or any(_absent(served, state)):
            try:
                state, record = self._registry.record(name)
            except UnknownModelError:  # it has vanished with its record
                pass
            except CazslError as error:  # an unreadable record removes nothing
                unreadable = f"{name}/history: {error}"
        missing, unnamed = _absent(served, state)
        problems = [f"{name}/{place}: {cause}" for place, cause in state.faults.items()]
        problems += [unreadable] if unreadable else []
        if not (state.versions or state.removed or record.events or problems):
            problems.append(f"{name} has neither a version nor a history")
        lost = missing - record.intended().removed
        kept = {alias: served.aliases[alias] for alias in unnamed if not record.gave_up(alias)}
        problems += [f"{name}@{version} has vanished without being removed and stays served" for version in lost]
        problems += [
            f"{name}@{alias} has vanished; {version} stays served"
            for alias, version in kept.items()
            if not state.is_unknown(alias)
        ]
        wanted = kept | dict(state.aliases)
        newest = sorted(state.versions)[-self._newest_versions :]
        versions: dict[int, LoadedModel] = {}
        for version in sorted({*newest, *wanted.values(), *lost}):
            try:
                versions[version] = served.versions.get(version) or self._loaded(name, version)
            except CazslError as error:
                self.counters.failures[name] += 1
                problems.append(f"{name}@{version} is broken and not served: {error}")
        aliases = {}
        for alias, version in wanted.items():
            before = served.aliases.get(alias)
            if version in versions:
                aliases[alias] = version
            elif before is not None and before in served.versions:
                versions[before] = served.versions[before]
                aliases[alias] = before
                problems.append(f"{name}@{alias} should be {version}; {before} stays served")
        recorded = bool(unreadable) or _champion_is_recorded(state, record)
        if recorded and DEFAULT_ALIAS not in wanted and not problems:
            problems.append(f"{name}@{DEFAULT_ALIAS} is recorded in the history, but has vanished")
        return ServedModel(versions, aliases, problems, recorded)

    def _loaded(self, name: str, version: int) -> LoadedModel:
        """Load a version. A bug that only one version meets is a fault of that version."""
        try:
            return load_version(self._registry, self._load, name, version)
        except CazslError:
            raise
        except Exception as error:
            logger.exception("version cannot be loaded", extra={"model": name, "version": version})
            raise BrokenModelError("it cannot be loaded; the log has the cause") from error

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


def _absent(served: ServedModel, state: ModelState) -> tuple[set[int], set[str]]:
    """Return the served versions that are neither there nor removed, and the served aliases that are not there."""
    return set(served.versions) - state.versions - state.removed, served.aliases.keys() - state.aliases.keys()


def _champion_is_recorded(state: ModelState, record: History) -> bool:
    """Return whether a model has a champion, or had one that no writer dropped.

    A history with faults may have lost the line that set the champion. A model without a version, and a model whose
    history shows that no version was promoted yet, has none.
    """
    if DEFAULT_ALIAS in state.aliases or state.is_unknown(DEFAULT_ALIAS):
        return True
    faulty = bool(record.problems) and not record.torn_bytes
    return faulty or DEFAULT_ALIAS in record.intended().aliases
