"""Requests and answers of plans from a pose to a goal, and of refinements by the outcomes of pushes, as arrays."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from service.client.arguments import Context, context_document, finite_array, lengths_field, pose_document, pose_rows
from service.client.calls import Call, Numbers, answer_array, check_warnings, model_field, post
from service.client.errors import UnreadableAnswerError
from service.client.planning_calls import Steps, read_steps
from service.schemas.contexts import ContextBody
from service.schemas.models import ModelVersionBody
from service.schemas.planning.plans import PlanResponse, ReasonBody
from service.schemas.planning.refinements import RefineResponse
from service.schemas.predictions import BatchWarningBody

_PUSH = 4  # x, y, angle, length


@dataclass(frozen=True, slots=True)
class Plan:
    """Plan of k pushes, or the reason why there is none. Make the first push, look, and plan again.

    Attributes:
        model: model and version that answered.
        pushes: (k, 4) x, y, angle, length of the pusher in the world, in m, m, rad, m. None are needed at the goal.
        steps: the object's pose after each push, if all are made without looking.
        collision_probability: (k,) share of the particles that touch something up to each push.
        goal_probability: probability of ending in the goal if all are made without looking.
        replanned_probability: probability that the last push ends in the goal if the plan is renewed after each push.
        reason: why there is no plan, with a code and its words, or None.
        stopped: whether the time budget was over before the work was done.
        warnings: reasons not to rely on some pushes.
    """

    model: ModelVersionBody
    pushes: Numbers
    steps: Steps
    collision_probability: Numbers
    goal_probability: float
    replanned_probability: float
    reason: ReasonBody | None
    stopped: bool
    warnings: tuple[BatchWarningBody, ...]


@dataclass(frozen=True, slots=True)
class Refinement:
    """Context of an object with what some pushes tell of its body.

    Attributes:
        model: model and version that answered.
        context: to be sent as the context of other requests. It has a ``posterior``.
        outliers: rows of the pushes that no body explains.
        warnings: reasons not to rely on the context, none if empty. Each has a code, a detail and the rows.
    """

    model: ModelVersionBody
    context: ContextBody
    outliers: tuple[int, ...]
    warnings: tuple[BatchWarningBody, ...]


def plan(
    context: Context,
    object_pose: npt.ArrayLike,
    goal: npt.ArrayLike,
    position_tolerance: float,
    angle_tolerance: float,
    max_pushes: int,
    lengths: npt.ArrayLike | None,
    workspace: npt.ArrayLike | None,
    obstacles: Sequence[npt.ArrayLike],
    clearance: float | None,
    time_s: float | None,
    seed: int,
    model: str | None,
) -> Call[Plan]:
    """Build the request for a plan."""
    document: dict[str, Any] = {
        "context": context_document(context),
        "object_pose": pose_document(object_pose, "object_pose"),
        "goal": pose_document(goal, "goal"),
        "position_tolerance": position_tolerance,
        "angle_tolerance": angle_tolerance,
        "max_pushes": max_pushes,
        "obstacles": [finite_array(each, f"obstacles.{number}").tolist() for number, each in enumerate(obstacles)],
        "seed": seed,
        **model_field(model),
    }
    if lengths is not None:
        document["lengths"] = np.atleast_1d(finite_array(lengths, "lengths")).tolist()
    if workspace is not None:
        document["workspace"] = finite_array(workspace, "workspace").tolist()
    given = {"clearance": clearance, "time_s": time_s}
    document |= {name: value for name, value in given.items() if value is not None}
    return post("/v1/plan", document, _plan)


def refine(
    context: Context,
    pushers: npt.ArrayLike,
    outcomes: npt.ArrayLike,
    lengths: npt.ArrayLike | None,
    object_poses: npt.ArrayLike | None,
    seed: int,
    model: str | None,
) -> Call[Refinement]:
    """Build the request for the context of an object that was pushed."""
    rows = pose_rows(pushers, "pushers")
    document = {
        "context": context_document(context),
        "pushers": rows,
        "outcomes": pose_rows(outcomes, "outcomes"),
        "seed": seed,
        **lengths_field(lengths),
        **model_field(model),
    }
    if object_poses is not None:
        document["object_poses"] = pose_rows(object_poses, "object_poses")

    def read(content: bytes) -> Refinement:
        """Return the answer."""
        body = RefineResponse.model_validate_json(content, extra="ignore")
        if not all(0 <= row < len(rows) for row in body.outliers):
            raise UnreadableAnswerError(f"the answer has outliers that are none of the {len(rows)} pushes")
        return Refinement(body.model, body.context, tuple(body.outliers), check_warnings(body.warnings, len(rows)))

    return post("/v1/contexts/refine", document, read)


def _plan(content: bytes) -> Plan:
    """Return a plan as arrays."""
    body = PlanResponse.model_validate_json(content, extra="ignore")
    count = len(body.pushes)
    rows = [[push.x, push.y, push.angle, push.length] for push in body.pushes]
    touched = [step.collision_probability for step in body.steps]
    return Plan(
        body.model,
        answer_array(rows, (count, _PUSH), np.float64) if count else np.zeros((0, _PUSH)),
        read_steps(body.steps, count),
        answer_array(touched, (count,), np.float64),
        body.goal_probability,
        body.replanned_probability,
        body.reason,
        body.stopped,
        check_warnings(body.warnings, count),
    )
