"""Gates of push models: laws of physics that a version must obey before an alias may name it. They need no data.

Figures are in units of the published output deviations. A tolerance is the model's own held-out RMSE: a law is not
broken by a prediction that misses it by the usual error of the model. Where two predictions are compared, each with
that error, the tolerance is sqrt(2) times as large.
"""

import math
from collections.abc import Iterator
from typing import Final

import numpy as np

from service.model.domain import Verdict
from service.model.loaded_model import LoadedModel
from service.model.tensors import ContextKind, FloatArray
from service.pushing.contexts import VISUAL_SIZE, ObjectContext
from service.pushing.poses import DoubleArray, wrap_angles

START_M: Final = 0.080  # from the centre of the object, where the benchmark's pushes start
BEARINGS_RAD: Final = tuple(-math.pi + 0.05 + 2.0 * math.pi * step / 24 for step in range(24))
OFFSETS_M: Final = tuple(
    0.0025 * step for step in range(-12, 13)
)  # beside the centre, within the outline of every object
STEP_RAD: Final = 1e-4  # on either side of pi
# Objects of every shape, with no, one or two weights, from the held-out half of the published split.
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
    """Run the gates of a version: no contact, turned objects, continuity of the angle at pi."""
    rmse = max(metrics.rmse for metrics in model.manifest.metrics.values())
    difference = math.sqrt(2.0) * rmse
    motion = _rms(model, _means(model, 0, _pushes(0.0)))
    yield _verdict("no-contact", motion, rmse, "rms motion of objects that the pusher moves away from")
    if model.manifest.context_kind is not ContextKind.NONE:  # an unknown object cannot be turned
        figure = max(_asymmetry(model, quarters) for quarters in (1, 2, 3))
        meaning = "rms difference between turned predictions and predictions for turned objects"
        yield _verdict("turned", figure, difference, meaning)
    yield _verdict("angle-at-pi", _jump(model), difference, "rms jump of the prediction where the angle passes pi")


def _verdict(gate: str, figure: float, limit: float, meaning: str) -> Verdict:
    return Verdict(gate, figure <= limit, figure, limit, f"{meaning}, in output deviations; limit {limit:.3f}")


def _pushes(heading_rad: float) -> DoubleArray:
    """Return pushes (24, 3) from all around. They head away from the centre for 0, and towards it for pi."""
    bearing = np.array(BEARINGS_RAD)
    return np.column_stack([START_M * np.cos(bearing), START_M * np.sin(bearing), wrap_angles(bearing + heading_rad)])


def _asymmetry(model: LoadedModel, quarters: int) -> float:
    """Return the rms difference between predictions for a turned scene and turned predictions."""
    pushes, turn = _pushes(math.pi), quarters * math.pi / 2.0
    turning = np.array([[math.cos(turn), math.sin(turn), 0.0], [-math.sin(turn), math.cos(turn), 0.0], [0.0, 0.0, 1.0]])
    turned = pushes @ turning
    turned[:, 2] = wrap_angles(pushes[:, 2] + turn)
    return _rms(model, _means(model, quarters, turned) - _means(model, 0, pushes) @ turning)


def _jump(model: LoadedModel) -> float:
    """Return the rms difference between predictions on the two sides of pi."""
    before, after = (
        np.array([[START_M, offset, angle] for offset in OFFSETS_M])
        for angle in (math.pi - STEP_RAD, STEP_RAD - math.pi)
    )
    return _rms(model, _means(model, 0, before) - _means(model, 0, after))


def _means(model: LoadedModel, quarters: int, pushes: DoubleArray) -> DoubleArray:
    """Return the means (objects, pushes, 3) of every push of every object turned by that many quarters."""
    context = _contexts(model, quarters)
    index = np.repeat(np.arange(len(context)), len(pushes))
    mean, _ = model.predictor.predict(np.tile(pushes, (len(context), 1)).astype(np.float32), context, index)
    return mean.astype(np.float64).reshape(len(context), len(pushes), 3)


def _contexts(model: LoadedModel, quarters: int) -> FloatArray:
    """Return the contexts of the objects above. A visual model has views instead, those of its self-check."""
    if model.manifest.context_kind is ContextKind.VISUAL:
        views = np.array(model.manifest.self_check.context, dtype=np.float32).reshape(-1, 1, VISUAL_SIZE, VISUAL_SIZE)
        return np.ascontiguousarray(np.rot90(views, quarters, axes=(2, 3)))  # x points right and y up in a view
    return np.stack([ObjectContext.from_descriptor(name).turned(quarters).indicator() for name in OBJECTS])


def _rms(model: LoadedModel, difference: DoubleArray) -> float:
    """Return the root mean square over all pushes and the 3 outputs, in units of the published output deviations."""
    difference = np.concatenate([difference[..., :2], wrap_angles(difference[..., 2:])], axis=-1)
    return float(np.sqrt(np.mean((difference / np.array(model.manifest.normalisation.output_std)) ** 2)))
