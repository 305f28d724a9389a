"""Answers to ``POST /v1/contexts/refine``: the context of an object with what a few pushes tell of its body."""

from typing import Final

import numpy as np

from service.api.planning.answers import planning_answer
from service.errors import InvalidRequestError
from service.inference.bodies_model import BodiesModel
from service.inference.object_model import ObjectModel
from service.inference.pushes import PushFields, push_rows, reach_m
from service.inference.query import Answer, ContextBatch, Warnings, predict
from service.inference.snapshot import Snapshot
from service.model.tensors import ContextKind, FloatArray
from service.planning.bodies import Bodies
from service.planning.refine import Refined, known_prior, refine, usual_prior
from service.pushing.shape_context import ShapeContext
from service.schemas.planning.refinements import RefineRequest, refined_body
from service.validity.codes import Angles
from service.validity.judging import find_warnings
from service.validity.refinements import refinement_warnings

_OUTLIER: Final = 0.5
_WHERE: Final = "body.context"


def answer_refine(models: Snapshot, request: RefineRequest) -> Answer:
    """Answer with the refined context of an object. Blocking: it predicts the pushes of some hundred bodies.

    Raises:
        RequestError: the pushes, the context or the reference to the model are not valid, or there are too many.
        ModelNotReadyError: see ``Snapshot.find``.
        PredictionError, DeadlineError: see ``query.predict``.
    """
    request.check_count()
    outcomes = request.object_outcomes()
    shape = request.context.to_domain(_WHERE)
    if not isinstance(shape, ShapeContext):
        accepted = "an outline, or an image with metres_per_pixel: an object whose body is not known"
        raise InvalidRequestError.at(_WHERE, f"a context of kind {shape.kind}", accepted)
    reference = request.reference()
    model = models.find_default(ContextKind.SHAPE) if reference is None else models.find(reference)
    asked = ObjectModel(model, _contexts(shape, len(outcomes)))
    lengths = request.lengths_m()
    fields = PushFields("body.pushers.{row}", "body.lengths" if len(lengths) == 1 else "body.lengths.{row}")
    pushes = push_rows(model, request.pusher_poses(reach_m(ContextKind.SHAPE)), lengths, asked.contexts, fields)
    bodies = Bodies(shape)
    moments = request.prior_moments()
    prior = usual_prior(bodies) if moments is None else known_prior(bodies, *moments)
    found = refine(BodiesModel(model, _WHERE), bodies, prior, pushes.astype(np.float64), outcomes, request.seed)
    outliers = np.flatnonzero(found.outlier_probability > _OUTLIER).tolist()
    context = refined_body(request.context, found.context, found.std, found.correlation)
    document = {"context": context.model_dump(exclude_none=True), "outliers": outliers}
    warnings = _warnings(asked, found, pushes, request.sent_angles(), outliers)
    return planning_answer(asked, "object", document, warnings, len(pushes))


def _warnings(asked: ObjectModel, found: Refined, pushes: FloatArray, angles: Angles, outliers: list[int]) -> Warnings:
    """Return the warnings about the pushes with the refined context, and about the refinement itself."""
    contexts = _contexts(found.context, len(pushes))
    predicted = predict(asked.model, pushes, contexts)
    usual = find_warnings(asked.model.manifest, pushes, angles, contexts, predicted)
    return (*usual, *refinement_warnings(found.std / found.prior_std, outliers, len(pushes)))


def _contexts(shape: ShapeContext, count: int) -> ContextBatch:
    """Return the context of this many pushes."""
    tensors = tuple(tensor[None] for tensor in shape.tensors())
    return ContextBatch(ContextKind.SHAPE, tensors, np.zeros(count, dtype=np.int64), _WHERE)
