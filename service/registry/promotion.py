"""Promotion of a version: gates, comparison with the champion, alias move."""

import math
from collections.abc import Iterator
from typing import Final

from service.model.loaded_model import LoadedModel
from service.model.manifest import Calibration
from service.pushing.gates import Verdict, _physics

LEVELS: Final = (0.50, 0.90, 0.95)


def judge(candidate: LoadedModel, champion: LoadedModel | None) -> list[Verdict]:
    """Every gate's verdict on a version that was loaded, and so passed verification and self-check."""
    return [*_physics(candidate), *([] if champion is None else _figures(candidate, champion))]


def _figures(candidate: LoadedModel, champion: LoadedModel) -> Iterator[Verdict]:
    """Held-out likelihood and coverage, set-up by set-up of the champion."""
    ours, theirs = candidate.manifest, champion.manifest
    same = ours.data.sha256 == theirs.data.sha256  # figures are named by the set-up that they were measured on
    for set_up in sorted(theirs.metrics):
        if not same or set_up not in ours.metrics:
            meaning = f"{set_up}: measured on other data than version {theirs.version}, and so not comparable"
            yield Verdict("held-out", False, math.inf, 0.0, meaning)
            continue
        nll, limit = ours.metrics[set_up].nll, theirs.metrics[set_up].nll
        yield Verdict(
            "nll", nll <= limit, nll, limit, f"{set_up}: NLL per push; version {theirs.version} has {limit:.3f}"
        )
        if set_up in ours.calibration and set_up in theirs.calibration:
            yield _coverage(set_up, ours.calibration[set_up], theirs.calibration[set_up], ours.data.held_out_pushes)


def _coverage(set_up: str, ours: Calibration, theirs: Calibration, pushes: int) -> Verdict:
    """How far the coverage is from its level, at the level where it is most beyond the champion's.

    Two standard errors of a share of that many pushes are allowed for chance.
    """

    def at(level: float, mine: float, other: float) -> tuple[float, float, float]:
        """Figure, limit and level."""
        chance = 2.0 * math.sqrt(level * (1.0 - level) / max(pushes, 1))
        return abs(mine - level), abs(other - level) + chance, level

    levels = [at(*each) for each in zip(LEVELS, _levels(ours), _levels(theirs), strict=True)]
    figure, limit, level = max(levels, key=lambda each: each[0] - each[1])
    meaning = f"{set_up}: distance of the coverage from {level:.0%}; may be {limit:.4f}"
    return Verdict("coverage", figure <= limit, figure, limit, meaning)


def _levels(calibration: Calibration) -> tuple[float, float, float]:
    return calibration.coverage_50, calibration.coverage_90, calibration.coverage_95
