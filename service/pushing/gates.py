"""What a version must show before an alias may name it: physics that needs no data, and figures against the champion.

Tolerances have one basis: the candidate's own held-out RMSE, in units of the published output deviations. A law of
physics that an answer breaks by no more than the model errs anyway is not broken; two answers that should agree, each
with that error, may differ by sqrt(2) of it. Held-out figures are those of the manifests, and count as compared only
where both versions were measured on the same data and set-up.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from service.inference.loaded_models import LoadedModel
from service.model.manifest import Calibration
from service.pushing.contexts import VISUAL_SIZE, ContextKind, FloatArray, ObjectContext

Array = npt.NDArray[np.float64]
START_M: Final = 0.080  # from the centre, where the benchmark's pushes start
BEARINGS_RAD: Final = tuple(-math.pi + 0.05 + 2.0 * math.pi * step / 24 for step in range(24))
OFFSETS_M: Final = tuple(0.0025 * step for step in range(-12, 13))  # beside the centre: within every object's outline
STEP_RAD: Final = 1e-4  # on either side of pi
LEVELS: Final = (0.50, 0.90, 0.95)
# Objects of every shape, with no, one and two weights, from the held-out half of the published division.
OBJECTS: Final = (
    "1a1a3a3a",
    "1a2a4a3a",
    "3a3a3a4a",
    "1a4a1a4a",
    "1a2c4a4a",
    "2b3a3b4a",
    "2B2b3a3a",
    "1b2B1a4a",
    "2c4a4a4a",
)


@dataclass(frozen=True)
class Verdict:
    """What one gate found: the figure, the most that it may be, and what both mean."""

    gate: str
    passed: bool
    figure: float
    limit: float
    meaning: str


def judge(candidate: LoadedModel, champion: LoadedModel | None) -> list[Verdict]:
    """Every gate's verdict on a version that was loaded, and so passed verification and self-check."""
    return [*_physics(candidate), *([] if champion is None else _figures(candidate, champion))]


def _physics(model: LoadedModel) -> Iterator[Verdict]:
    rmse = max(metrics.rmse for metrics in model.manifest.metrics.values())
    found = _rms(model, _means(model, 0, _pushes(0.0)))
    yield _verdict("no-contact", found, rmse, "rms motion of objects that the pusher moves away from")
    if model.manifest.context_kind is not ContextKind.NONE:  # an unknown object cannot be turned
        found = max(_turned(model, quarters) for quarters in (1, 2, 3))
        yield _verdict(
            "turned",
            found,
            math.sqrt(2.0) * rmse,
            "rms difference between turned answers and answers to turned objects",
        )
    yield _verdict(
        "angle-at-pi", _jump(model), math.sqrt(2.0) * rmse, "rms jump of the answer where the angle passes pi"
    )


def _verdict(gate: str, figure: float, limit: float, meaning: str) -> Verdict:
    return Verdict(gate, figure <= limit, figure, limit, f"{meaning}, in output deviations; may be {limit:.3f}")


def _pushes(heading_rad: float) -> Array:
    """Pushes from all around, heading away from the centre or, turned by pi, towards it; (24, 3)."""
    bearing = np.array(BEARINGS_RAD)
    return np.column_stack([START_M * np.cos(bearing), START_M * np.sin(bearing), _wrapped(bearing + heading_rad)])


def _turned(model: LoadedModel, quarters: int) -> float:
    """How far answers to a turned scene are from turned answers, rms."""
    pushes, turn = _pushes(math.pi), quarters * math.pi / 2.0
    turning = np.array([[math.cos(turn), math.sin(turn), 0.0], [-math.sin(turn), math.cos(turn), 0.0], [0.0, 0.0, 1.0]])
    turned = pushes @ turning
    turned[:, 2] = _wrapped(pushes[:, 2] + turn)
    return _rms(model, _means(model, quarters, turned) - _means(model, 0, pushes) @ turning)


def _jump(model: LoadedModel) -> float:
    """How far apart answers are on the two sides of pi, rms."""
    before, after = (
        np.array([[START_M, offset, angle] for offset in OFFSETS_M])
        for angle in (math.pi - STEP_RAD, STEP_RAD - math.pi)
    )
    return _rms(model, _means(model, 0, before) - _means(model, 0, after))


def _means(model: LoadedModel, quarters: int, pushes: Array) -> Array:
    """Mean poses of every push of every object turned by that many quarters, (objects, pushes, 3)."""
    context = _contexts(model, quarters)
    index = np.repeat(np.arange(len(context)), len(pushes))
    mean, _ = model.predictor.predict(np.tile(pushes, (len(context), 1)).astype(np.float32), context, index)
    return mean.astype(np.float64).reshape(len(context), len(pushes), 3)


def _contexts(model: LoadedModel, quarters: int) -> FloatArray:
    """Objects to push: the panel above, or the views that the version carries for its self-check."""
    if model.manifest.context_kind is ContextKind.VISUAL:
        views = np.array(model.manifest.self_check.context, dtype=np.float32).reshape(-1, 1, VISUAL_SIZE, VISUAL_SIZE)
        return np.ascontiguousarray(np.rot90(views, quarters, axes=(2, 3)))  # x points right and y up in a view
    return np.stack([ObjectContext.from_descriptor(name).turned(quarters).indicator() for name in OBJECTS])


def _rms(model: LoadedModel, difference: Array) -> float:
    """Root mean square over all pushes and the 3 outputs, in units of the published output deviations."""
    difference = np.concatenate([difference[..., :2], _wrapped(difference[..., 2:])], axis=-1)
    return float(np.sqrt(np.mean((difference / np.array(model.manifest.normalisation.output_std)) ** 2)))


def _wrapped(angle_rad: Array) -> Array:
    return np.remainder(angle_rad + math.pi, 2.0 * math.pi) - math.pi


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
