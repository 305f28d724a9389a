"""What a version must show before an alias may name it: physics that needs no data, and figures against the champion.

Tolerances have one basis: the candidate's own held-out RMSE, in units of the published output deviations. A law of
physics that an answer breaks by no more than the model errs anyway is not broken; two answers that should agree, each
with that error, may differ by sqrt(2) of it. Held-out figures are those of the manifests, and count as compared only
where both versions were measured on the same data and set-up.
"""

import math
from collections.abc import Iterator
from typing import Final

import numpy as np
import numpy.typing as npt

from service.model.domain import Verdict
from service.model.loaded_model import LoadedModel
from service.model.tensors import ContextKind, FloatArray
from service.pushing.contexts import VISUAL_SIZE, ObjectContext
from service.pushing.poses import wrap_angles

Array = npt.NDArray[np.float64]
START_M: Final = 0.080  # from the centre, where the benchmark's pushes start
BEARINGS_RAD: Final = tuple(-math.pi + 0.05 + 2.0 * math.pi * step / 24 for step in range(24))
OFFSETS_M: Final = tuple(0.0025 * step for step in range(-12, 13))  # beside the centre: within every object's outline
STEP_RAD: Final = 1e-4  # on either side of pi
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


def physics_gates(model: LoadedModel) -> Iterator[Verdict]:
    """Run the gates that need no data: no contact, turned objects, continuity of the angle at pi."""
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
    return np.column_stack([START_M * np.cos(bearing), START_M * np.sin(bearing), wrap_angles(bearing + heading_rad)])


def _turned(model: LoadedModel, quarters: int) -> float:
    """How far answers to a turned scene are from turned answers, rms."""
    pushes, turn = _pushes(math.pi), quarters * math.pi / 2.0
    turning = np.array([[math.cos(turn), math.sin(turn), 0.0], [-math.sin(turn), math.cos(turn), 0.0], [0.0, 0.0, 1.0]])
    turned = pushes @ turning
    turned[:, 2] = wrap_angles(pushes[:, 2] + turn)
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
    difference = np.concatenate([difference[..., :2], wrap_angles(difference[..., 2:])], axis=-1)
    return float(np.sqrt(np.mean((difference / np.array(model.manifest.normalisation.output_std)) ** 2)))
