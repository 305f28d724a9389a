"""Answers to ``POST /v1/plan``: from a pose to a goal, among obstacles."""

from time import monotonic

import numpy as np

from service.api.planning.answers import of_all_rows, planning_answer, step_documents
from service.api.planning.objects import OutlinedObject, check_length, find_outlined_object
from service.inference.query import Answer, Warnings
from service.inference.snapshot import Snapshot
from service.planning.plan import Plan, PlanTask, plan
from service.pushing.poses import PUSH_LENGTH_M, DoubleArray
from service.schemas.planning.plans import USUAL_LENGTHS_M, PlanRequest
from service.validity.rollouts import rollout_warnings

_PUSH: tuple[str, ...] = ("x", "y", "angle", "length")


def answer_plan(models: Snapshot, request: PlanRequest) -> Answer:
    """Answer with a plan, or with the reason why there is none. Blocking: it searches.

    Raises:
        RequestError: the context has no outline, or a length, a polygon or the reference to the model is not valid.
        ModelNotReadyError: see ``Snapshot.find``.
        PredictionError, DeadlineError: see ``query.predict``.
    """
    surroundings = request.surroundings()
    asked = find_outlined_object(models, request, request.context)
    task = PlanTask(
        request.start(),
        request.region(),
        _lengths(request, asked),
        request.max_pushes,
        surroundings,
        request.clearance,
        request.time_s,
        request.seed,
    )
    found = plan(asked.model, asked.outline, asked.pusher_radius_m, task, monotonic)
    body = {
        "pushes": [dict(zip(_PUSH, push, strict=True)) for push in found.pushes.tolist()],
        "steps": _steps(found),
        "goal_probability": found.goal_probability,
        "replanned_probability": found.replanned_probability,
        "reason": None if found.reason is None else {"code": found.reason, "detail": found.detail},
        "stopped": found.stopped,
    }
    of_object = of_all_rows(asked.model.object_warnings(request.sent_angles()), len(found.pushes))
    return planning_answer(asked.model, "world", body, (*_of_pushes(found), *of_object), found.candidates)


def _lengths(request: PlanRequest, asked: OutlinedObject) -> DoubleArray:
    """Return the allowed lengths, ascending."""
    if request.lengths is None:
        return np.array(USUAL_LENGTHS_M if asked.model.knows_lengths else (PUSH_LENGTH_M,))
    for number, length_m in enumerate(request.lengths):
        check_length(asked.model, length_m, f"body.lengths.{number}")
    return np.unique(request.lengths)


def _steps(found: Plan) -> list[dict[str, object]]:
    """Return the documents of the steps."""
    if found.outcome is None:
        return []
    touched = found.collision_probability.tolist()
    return [
        {**step, "collision_probability": share}
        for step, share in zip(step_documents(found.outcome)[0], touched, strict=True)
    ]


def _of_pushes(found: Plan) -> Warnings:
    """Return the warnings of the pushes, whose rows are pushes."""
    if found.outcome is None:
        return ()
    outcome = found.outcome
    shares = outcome.miss_probability, outcome.inside_probability, outcome.unfamiliar_probability
    return rollout_warnings(np.stack(shares), by_sequence=False)
