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
import math
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from service.errors import (
    CazslError,
    ContextKindError,
    FieldFault,
    ModelNotReadyError,
    UnknownModelError,
)
from service.inference.counters import Tally
from service.model.manifest import DEFAULT_ALIAS, Manifest, ModelReference
from service.model.predictor import Predictor
from service.model.self_check import check_itself
from service.observability.timings import took
from service.pushing.contexts import (
    ContextKind,
    FloatArray,
    GaussianPose,
    IndexArray,
    ObjectContext,
    Pose,
    VisualContext,
)
from service.pushing.poses import wrap_angles
from service.registry.registry import Registry
from service.storage.history import ModelState

PredictorFactory = Callable[[bytes, ContextKind], Predictor]
DEFAULT_MODELS: Final[Mapping[ContextKind, str]] = {kind: f"push-{kind}" for kind in ContextKind}
# Files that hands or other tools moved need not show in a fingerprint: every so many looks, one looks at everything.
THOROUGH_EVERY: Final = 30
_DEFAULTS: Final = {kind: ModelReference(name, DEFAULT_ALIAS, None) for kind, name in DEFAULT_MODELS.items()}
FIRST_OBJECT: Final = np.zeros(1, dtype=np.int64)
_LARGEST_ANGLE: Final = np.nextafter(np.float32(math.pi), np.float32(0.0))  # float32's pi is beyond pi

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class LoadedModel:
    """One version that passed every check."""

    manifest: Manifest
    card: str
    predictor: Predictor

    def predict(
        self, pushers: FloatArray, kind: ContextKind, contexts: FloatArray | None, places: IndexArray | None
    ) -> tuple[FloatArray, FloatArray]:
        """Mean and std (n, 3), in the object frame, of pushes (n, 3) of the objects ``contexts[places]``.

        The angles of the means are wrapped.

        Raises:
            ContextKindError: the contexts are not of the kind that the model wants.
            PredictionError: the runtime failed.
        """
        if kind is not self.manifest.context_kind:
            accepted = f"a context of kind {self.manifest.context_kind} for {self.manifest.name}"
            raise ContextKindError([FieldFault("body.context", f"kind {kind}", accepted)])
        began = time.perf_counter()
        mean, std = self.predictor.predict(pushers, contexts, places)
        took("inference", time.perf_counter() - began)
        angles = mean[:, 2]
        inside = -_LARGEST_ANGLE <= angles[0] <= _LARGEST_ANGLE if len(angles) == 1 else _all_inside(angles)
        if not inside:
            mean = mean.copy()
            mean[:, 2] = np.clip(wrap_angles(angles.astype(np.float64)), -_LARGEST_ANGLE, _LARGEST_ANGLE)
        return mean, std

    def predict_push(self, pusher: Pose, context: ObjectContext | VisualContext | None) -> GaussianPose:
        """Where the object ends up after one push, in the object frame.

        Raises:
            ContextKindError, PredictionError: as ``predict``.
        """
        poses = np.array([[pusher.x_m, pusher.y_m, pusher.angle_rad]], dtype=np.float32)
        tensor, places = (None, None) if context is None else (context.tensor()[None], FIRST_OBJECT)
        mean, std = self.predict(poses, context_kind_of(context), tensor, places)
        return GaussianPose(Pose(*mean[0].tolist()), Pose(*std[0].tolist()))


def _all_inside(angles: FloatArray) -> bool:
    return bool(angles.max() <= _LARGEST_ANGLE and angles.min() >= -_LARGEST_ANGLE)


def context_kind_of(context: ObjectContext | VisualContext | None) -> ContextKind:
    """The kind of context that was given."""
    return ContextKind.NONE if context is None else context.kind


@dataclass(frozen=True)
class Snapshot:
    """What is served at one instant."""

    models: Mapping[tuple[str, int], LoadedModel] = field(default_factory=dict)
    aliases: Mapping[tuple[str, str], int] = field(default_factory=dict)
    problems: tuple[str, ...] = ("the registry was not read yet",)

    def find(self, reference: ModelReference) -> LoadedModel:
        """The model that a reference means in this snapshot.

        Raises:
            UnknownModelError: it is not served.
            ModelNotReadyError: nothing at all is served yet.
        """
        version = reference.version
        if reference.alias is not None:
            version = self.aliases.get((reference.name, reference.alias))
        model = None if version is None else self.models.get((reference.name, version))
        if model is not None:
            return model
        if not self.models:
            raise ModelNotReadyError(
                f"no model is loaded: {self.problems[0] if self.problems else 'none is published'}"
            )
        served = ", ".join(f"{name}@{number}" for name, number in sorted(self.models)[:10])
        raise UnknownModelError(f"model: received a reference that is not served; accepted is one of: {served}")

    def find_default(self, kind: ContextKind) -> LoadedModel:
        """The champion of the default model for this kind of context.

        Raises:
            UnknownModelError, ModelNotReadyError: as ``find``.
        """
        return self.find(_DEFAULTS[kind])

    def versions(self, name: str) -> list[int]:
        """The served versions of a model, oldest first.

        Raises:
            UnknownModelError: none is served.
        """
        numbers = sorted(number for model, number in self.models if model == name)
        if not numbers:
            raise UnknownModelError(f"name: received a model that is not served; accepted is one of: {self._names()}")
        return numbers

    def aliases_of(self, name: str) -> dict[str, int]:
        """The aliases of a model and what they mean here."""
        return {alias: version for (model, alias), version in self.aliases.items() if model == name}

    def _names(self) -> str:
        return ", ".join(sorted({name for name, _ in self.models})) or "none"


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


def load_version(registry: Registry, load: PredictorFactory, name: str, version: int) -> LoadedModel:
    """A version, verified in the written order: format, sizes, digests, tensors, self-check.

    Raises:
        BrokenModelError: it fails one of them.
    """
    verified = registry.read(name, version)
    predictor = load(verified.model, verified.manifest.context_kind)
    check_itself(verified.manifest, predictor)
    return LoadedModel(verified.manifest, verified.card, predictor)
