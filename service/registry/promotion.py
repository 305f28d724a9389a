"""Promotion of a version: run the gates, compare with the champion, move the alias. A rollback runs them too.

A version must pass the physics gates of its domain, and its held-out figures must not be worse than those of the
version that the alias names now. The figures are those of the manifests. They are comparable only if both versions were
measured on the same data and set-up. For a champion of other data, the candidate's manifest may hold the champion's
figures on the candidate's data, measured when the candidate was published.
"""

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Final

from service.errors import CazslError, ConflictError, UnknownModelError
from service.model.domain import Domain, Verdict
from service.model.loaded_model import LoadedModel
from service.model.manifest import Calibration
from service.model.predictor import PredictorFactory
from service.model.reference import ModelReference
from service.registry.loading import load_version
from service.registry.registry import NOWHERE, Registry
from service.storage.history import Event, History

LEVELS: Final = (0.50, 0.90, 0.95)
_FORCED: Final = "forced past"  # in the reason of a move that gates refused


@dataclass(frozen=True)
class Promotion:
    """Outcome of a promotion: the verdict of every gate, and the event of the alias move unless a gate refused it.

    Attributes:
        verdicts: verdict of every gate.
        event: event of the move. None: the alias stays.
        version: version that was to be promoted.
        seen: version that the alias named when the gates ran, ``NOWHERE`` for none.
    """

    verdicts: tuple[Verdict, ...]
    event: Event | None
    version: int
    seen: int

    @property
    def refused(self) -> tuple[Verdict, ...]:
        """Return the verdicts of the gates that the version did not pass."""
        return tuple(verdict for verdict in self.verdicts if not verdict.passed)


def promote(
    registry: Registry,
    load: PredictorFactory,
    name: str,
    version: int,
    alias: str,
    *,
    reason: str | None = None,
    expect: int | None = None,
    force: bool = False,
) -> Promotion:
    """Run the gates on a version, then point an alias at it.

    Args:
        registry: registry of the model.
        load: creates predictors.
        name: name of the model.
        version: version to promote, the candidate.
        alias: alias to move.
        reason: reason that the history keeps.
        expect: version that the alias must name at the instant of the move, ``NOWHERE`` for none. None: the version
            that it named when the gates ran.
        force: move the alias although gates refuse. The history then keeps their figures.

    Raises:
        UnknownModelError: there is no such version.
        BrokenModelError: the candidate does not pass verification or its self-check.
        ConflictError: the alias does not name the expected version. It stays.
        RegistryError: the storage refused.
    """
    registry.resolve(ModelReference(name, None, version))
    current = registry.aliases(name).get(alias)
    candidate = load_version(registry, load, name, version)
    verdicts = judge(candidate, _champion(registry, load, name, current), registry.domain)
    seen = expect if expect is not None else (current or NOWHERE)
    return _move(registry, name, alias, Promotion(tuple(verdicts), None, version, seen), reason, force)


def roll_back(
    registry: Registry,
    load: PredictorFactory,
    name: str,
    alias: str,
    *,
    reason: str | None = None,
    expect: int | None = None,
    force: bool = False,
) -> Promotion:
    """Run the gates on the version that an alias named before, then point it back at that version.

    Held-out figures are not compared: the version that is left may have the better ones, and fail in the field.

    Args:
        registry: registry of the model.
        load: creates predictors.
        name: name of the model.
        alias: alias to move.
        reason: reason that the history keeps.
        expect: version that the alias must name. None: any version.
        force: move the alias although gates refuse. The history then keeps their figures.

    Raises:
        UnknownModelError: the alias named no other version that is still there.
        BrokenModelError: that version does not pass verification or its self-check.
        ConflictError: the alias does not name the expected version. It stays.
        RegistryError: the storage refused.
    """
    state = registry.state(name)
    current = state.aliases.get(alias)
    before = _before(registry.history(name), alias, current, state.versions)
    if current is None or before is None:
        raise UnknownModelError(f"{name}@{alias} named no other version before that is still there")
    if expect not in (None, current):
        raise ConflictError(f"{name}@{alias} names {current}, but {expect} was expected; the alias stays")
    verdicts = judge(load_version(registry, load, name, before), None, registry.domain)
    why = f"rollback: {reason}" if reason else "rollback"
    return _move(registry, name, alias, Promotion(tuple(verdicts), None, before, current), why, force)


def _move(registry: Registry, name: str, alias: str, found: Promotion, reason: str | None, force: bool) -> Promotion:
    """Point an alias at a version unless gates refuse it, and return the outcome with the event."""
    if found.refused and not force:
        return found
    if found.refused:
        reason = f"{reason or 'no reason given'} ({_FORCED} {refusals(found.refused)})"
    return replace(found, event=registry.point_alias(name, alias, found.version, expect=found.seen, reason=reason))


def refusals(verdicts: Iterable[Verdict]) -> str:
    """Return the gates that refuse, with their figures and limits, as a text."""
    return ", ".join(
        f"{verdict.gate} {verdict.figure:.3g} > {verdict.limit:.3g}" for verdict in verdicts if not verdict.passed
    )


def is_forced(history: History, alias: str, version: int) -> bool:
    """Return whether the last move of an alias led to this version past gates that refused it."""
    last = next((event for event in reversed(history.events) if event.alias == alias), None)
    return last is not None and last.to == version and _FORCED in (last.reason or "")


def judge(candidate: LoadedModel, champion: LoadedModel | None, domain: Domain) -> list[Verdict]:
    """Return the verdict of every gate on a loaded version, which has passed verification and self-check."""
    return [*domain.gates(candidate), *([] if champion is None else _figures(candidate, champion))]


def _champion(registry: Registry, load: PredictorFactory, name: str, version: int | None) -> LoadedModel | None:
    """Load the version to compare with. A version that does not load is not compared."""
    try:
        return None if version is None else load_version(registry, load, name, version)
    except CazslError:
        return None


def _before(history: History, alias: str, current: int | None, versions: frozenset[int]) -> int | None:
    """Return the last version that the alias named and that is neither the current one nor removed."""
    named = [event.to for event in history.events if event.alias == alias and event.to is not None]
    return next((version for version in reversed(named) if version != current and version in versions), None)


def _figures(candidate: LoadedModel, champion: LoadedModel) -> Iterator[Verdict]:
    """Compare held-out likelihood and coverage for each set-up of the champion."""
    ours, theirs = candidate.manifest, champion.manifest
    # Figures are named by the set-up that they were measured on.
    same = ours.data.sha256 == theirs.data.sha256
    known = theirs if same else (ours.rivals or {}).get(str(theirs.version))
    for set_up in sorted((known or theirs).metrics):
        if known is None or set_up not in ours.metrics:
            meaning = f"{set_up}: not measured on the data of version {theirs.version}, so not comparable"
            yield Verdict("held-out", False, math.inf, 0.0, meaning)
            continue
        nll, limit = ours.metrics[set_up].nll, known.metrics[set_up].nll
        yield Verdict(
            "nll", nll <= limit, nll, limit, f"{set_up}: NLL per push; version {theirs.version} has {limit:.3f}"
        )
        if set_up in ours.calibration and set_up in known.calibration:
            yield _coverage(set_up, ours.calibration[set_up], known.calibration[set_up], ours.data.held_out_pushes)


def _coverage(set_up: str, ours: Calibration, theirs: Calibration, pushes: int) -> Verdict:
    """Compare the distance of the coverage from its level, at the level where it exceeds that of the champion most.

    The limit allows two standard errors of a share of this number of pushes.
    """

    def at(level: float, mine: float, other: float) -> tuple[float, float, float]:
        """Return figure, limit and level."""
        chance = 2.0 * math.sqrt(level * (1.0 - level) / max(pushes, 1))
        return abs(mine - level), abs(other - level) + chance, level

    levels = [at(*each) for each in zip(LEVELS, _levels(ours), _levels(theirs), strict=True)]
    figure, limit, level = max(levels, key=lambda each: each[0] - each[1])
    meaning = f"{set_up}: distance of the coverage from {level:.0%}; limit {limit:.4f}"
    return Verdict("coverage", figure <= limit, figure, limit, meaning)


def _levels(calibration: Calibration) -> tuple[float, float, float]:
    return calibration.coverage_50, calibration.coverage_90, calibration.coverage_95
