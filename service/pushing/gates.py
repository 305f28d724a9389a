"""Planar pushing as a domain for the registry: the tensors of push models, and the gates that each must pass.

Gates are laws of physics that a version must obey before an alias may name it. They need no data.

Figures are in units of the published output deviations. A tolerance is the model's own held-out RMSE: a law is not
broken by a prediction that misses it by the usual error of the model. Where two predictions are compared, each with
that error, the tolerance is sqrt(2) times as large. A shape model knows where an object begins, so it has more laws to
keep: a push that misses leaves the object exactly where it is.
"""

import math
from collections.abc import Callable, Iterable, Iterator
from typing import Final

import numpy as np

from service.model.domain import Verdict
from service.model.loaded_model import LoadedModel
from service.model.self_check import stored_contexts
from service.model.tensors import ContextKind, FloatArray, Tensor
from service.pushing.contexts import ObjectContext
from service.pushing.onnx_interface import OUTPUTS, OUTPUTS_WITH_UNFAMILIARITY, UNFAMILIARITY_SINCE, expected_inputs
from service.pushing.outlines import Outline
from service.pushing.poses import PUSH_LENGTH_M, DoubleArray, wrap_angles
from service.pushing.shape_context import ShapeContext

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
# Objects of a shape model in mm: a box, a triangle, an L, and a blunt arrow. None reaches the start of a push.
OUTLINES_MM: Final = (
    ((60, 40), (-60, 40), (-60, -40), (60, -40)),
    ((55, -10), (-30, 45), (-35, -35)),
    ((40, -20), (40, 0), (0, 0), (0, 45), (-25, 45), (-25, -20)),
    ((65, 0), (25, 30), (-30, 15), (-45, -25), (20, -30)),
)
RADIUS_M: Final = 0.005  # of the tip
SHAPE_TURNS_RAD: Final = (1.0, math.pi / 2.0, math.pi)
Contexts = tuple[FloatArray, ...]


def physics_gates(model: LoadedModel) -> Iterator[Verdict]:
    """Run the gates of a version: no contact, turned objects, continuity of the angle at pi.

    Those of a shape model are also mirrored objects, and scale: twice the size and twice the push are twice the answer.
    """
    rmse = max(metrics.rmse for metrics in model.manifest.metrics.values())
    difference = math.sqrt(2.0) * rmse
    shape = model.manifest.context_kind is ContextKind.SHAPE
    motion = _rms(model, _means(model, _contexts(model, 0.0), _pushes(0.0)))
    limit = 0.0 if shape else rmse
    yield _verdict("no-contact", motion, limit, "rms motion of objects that the pusher moves away from")
    if model.manifest.context_kind is not ContextKind.NONE:  # an unknown object cannot be turned
        turns = SHAPE_TURNS_RAD if shape else tuple(quarters * math.pi / 2.0 for quarters in (1, 2, 3))
        figure = max(_asymmetry(model, turn) for turn in turns)
        meaning = "rms difference between turned predictions and predictions for turned objects"
        yield _verdict("turned", figure, difference, meaning)
    if shape:
        meaning = "rms difference between mirrored predictions and predictions for mirrored objects"
        yield _verdict("mirrored", _handedness(model), difference, meaning)
        meaning = "rms difference between predictions, and half of those for twice the size and twice the push"
        yield _verdict("scale", _dilation(model), difference, meaning)
    yield _verdict("angle-at-pi", _jump(model), difference, "rms jump of the prediction where the angle passes pi")


def _verdict(gate: str, figure: float, limit: float, meaning: str) -> Verdict:
    return Verdict(gate, figure <= limit, figure, limit, f"{meaning}, in output deviations; limit {limit:.3f}")


def _pushes(heading_rad: float) -> DoubleArray:
    """Return pushes (24, 3) from all around. They head away from the centre for 0, and towards it for pi."""
    bearing = np.array(BEARINGS_RAD)
    return np.column_stack([START_M * np.cos(bearing), START_M * np.sin(bearing), wrap_angles(bearing + heading_rad)])


def _asymmetry(model: LoadedModel, turn: float) -> float:
    """Return the rms difference between predictions for a turned scene and turned predictions."""
    pushes, cos, sin = _pushes(math.pi), math.cos(turn), math.sin(turn)
    turning = np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])
    turned = pushes @ turning
    turned[:, 2] = wrap_angles(pushes[:, 2] + turn)
    found = _means(model, _contexts(model, turn), turned)
    return _rms(model, found - _means(model, _contexts(model, 0.0), pushes) @ turning)


def _handedness(model: LoadedModel) -> float:
    """Return the rms difference between predictions for a scene mirrored at the x axis and mirrored predictions."""
    pushes, mirror = _pushes(math.pi), np.array([1.0, -1.0, -1.0])
    found = _means(model, _shapes(lambda corners: corners * mirror[:2]), pushes * mirror)
    return _rms(model, found - _means(model, _contexts(model, 0.0), pushes) * mirror)


def _dilation(model: LoadedModel) -> float:
    """Return the rms difference between predictions and those for a scene of twice the size, made as small again."""
    pushes, twice = _pushes(math.pi), np.array([2.0, 2.0, 1.0])
    found = _means(model, _shapes(lambda corners: 2.0 * corners, 2.0), pushes * twice, 2.0)
    return _rms(model, found / twice - _means(model, _contexts(model, 0.0), pushes))


def _jump(model: LoadedModel) -> float:
    """Return the rms difference between predictions on the two sides of pi."""
    contexts = _contexts(model, 0.0)
    before, after = (
        np.array([[START_M, offset, angle] for offset in OFFSETS_M])
        for angle in (math.pi - STEP_RAD, STEP_RAD - math.pi)
    )
    return _rms(model, _means(model, contexts, before) - _means(model, contexts, after))


def _means(model: LoadedModel, contexts: Contexts, pushes: DoubleArray, scale: float = 1.0) -> DoubleArray:
    """Return the means (objects, pushes, 3) of every push of every object, for shapes of 50 mm times ``scale``."""
    objects = len(contexts[0]) if contexts else 1
    if model.manifest.context_kind is ContextKind.SHAPE:
        pushes = np.column_stack([pushes, np.full(len(pushes), PUSH_LENGTH_M * scale)])
    index = np.repeat(np.arange(objects), len(pushes)) if contexts else None
    found = model.predictor.predict(np.tile(pushes, (objects, 1)).astype(np.float32), contexts, index)
    return found.mean.astype(np.float64).reshape(objects, len(pushes), 3)


def _contexts(model: LoadedModel, turn: float) -> Contexts:
    """Return the contexts of the objects above, turned about their origin.

    A visual model has views instead, and a meta-learner supports: those of its self-check.
    """
    quarters = round(turn / (math.pi / 2.0))
    match model.manifest.context_kind:
        case ContextKind.NONE:
            return ()
        case ContextKind.VISUAL:
            views = stored_contexts(model.manifest)[0]
            return (np.ascontiguousarray(np.rot90(views, quarters, axes=(2, 3))),)  # x points right and y up in a view
        case ContextKind.SUPPORT:
            pushers, outcomes, valid = stored_contexts(model.manifest)
            return _turned(pushers, turn, turn), _turned(outcomes, turn, 0.0), valid
        case ContextKind.SHAPE:
            turning = np.array([[math.cos(turn), math.sin(turn)], [-math.sin(turn), math.cos(turn)]])
            return _shapes(lambda corners: corners @ turning)
        case ContextKind.INDICATOR:
            return (np.stack([ObjectContext.from_descriptor(name).turned(quarters).indicator() for name in OBJECTS]),)


def _turned(poses: FloatArray, turn: float, heading: float) -> FloatArray:
    """Return poses (g, k, 3) of a scene that is turned about the origin. ``heading`` is added to their angles."""
    cos, sin = math.cos(turn), math.sin(turn)
    places = poses[..., :2].astype(np.float64) @ np.array([[cos, sin], [-sin, cos]])
    angles = wrap_angles(poses[..., 2:].astype(np.float64) + heading)
    return np.concatenate([places, angles], axis=-1).astype(np.float32)


def _shapes(moved: Callable[[DoubleArray], DoubleArray], scale: float = 1.0) -> Contexts:
    """Return the contexts of the outlines above, moved, and pushed by a tip whose radius is times ``scale``."""
    outlines = [Outline.of(moved(np.array(corners) / 1000.0)) for corners in OUTLINES_MM]
    found = [ShapeContext(outline, pusher_radius_m=scale * RADIUS_M).tensors() for outline in outlines]
    return tuple(map(np.stack, zip(*found, strict=True)))


def _rms(model: LoadedModel, difference: DoubleArray) -> float:
    """Return the root mean square over all pushes and the 3 outputs, in units of the published output deviations."""
    difference = np.concatenate([difference[..., :2], wrap_angles(difference[..., 2:])], axis=-1)
    return float(np.sqrt(np.mean((difference / np.array(model.manifest.normalisation.output_std)) ** 2)))


class PushDomain:
    """See ``service.model.domain.Domain``."""

    def inputs(self, kind: ContextKind) -> tuple[Tensor, ...]:
        """See ``Domain.inputs``."""
        return expected_inputs(kind)

    def outputs(self, kind: ContextKind, manifest_format: int) -> tuple[tuple[Tensor, ...], ...]:
        """See ``Domain.outputs``."""
        if kind in (ContextKind.SHAPE, ContextKind.SUPPORT):
            return (OUTPUTS_WITH_UNFAMILIARITY,)
        return (OUTPUTS,) if manifest_format < UNFAMILIARITY_SINCE else (OUTPUTS, OUTPUTS_WITH_UNFAMILIARITY)

    def gates(self, model: LoadedModel) -> Iterable[Verdict]:
        """See ``Domain.gates``."""
        return physics_gates(model)


PUSHING: Final = PushDomain()
