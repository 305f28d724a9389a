"""Requests and answers of planning: sequences of pushes, as arrays in the world."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from service.client.arguments import (
    POSE_PARTS,
    Context,
    context_document,
    finite_array,
    pose_document,
)
from service.client.calls import MAX_ANSWER_BYTES, Call, Numbers, answer_array, check_warnings, model_field, post
from service.client.errors import ProblemError, UnreadableAnswerError
from service.schemas.models import ModelVersionBody
from service.schemas.planning.push_maps import PushMapResponse
from service.schemas.planning.rollouts import MOST_RETURNED, RolloutResponse, RolloutsResponse, SequenceBody, StepBody
from service.schemas.predictions import BatchWarningBody
from service.schemas.rows import MAX_PUSHES

_STEP_BYTES: Final = 1024
_PARTICLE_BYTES: Final = 96


@dataclass(frozen=True, slots=True)
class Region:
    """Region of poses in the world: a disc around a place, and an interval around an angle.

    Attributes:
        pose: (3,) x, y, angle of the middle, in m, m, rad.
        position_tolerance: radius of the disc, in m.
        angle_tolerance: half of the interval, in rad.
    """

    pose: npt.ArrayLike
    position_tolerance: float
    angle_tolerance: float

    def document(self) -> dict[str, float]:
        """Return the document of the region."""
        tolerances = {"position_tolerance": self.position_tolerance, "angle_tolerance": self.angle_tolerance}
        return {**pose_document(self.pose, "region"), **tolerances}


@dataclass(frozen=True, slots=True)
class Steps:
    """Poses of the object after each of k pushes, in the world.

    Attributes:
        mean: (k, 3) x, y, angle in m, m, rad.
        covariance: (k, 3, 3) of them.
        miss_probability: (k,) share of the particles that each push never touches.
        inside_probability: (k,) share of the particles that the pusher starts inside of.
        unfamiliar_probability: (k,) share of the particles whose push the model does not vouch for.
    """

    mean: Numbers
    covariance: Numbers
    miss_probability: Numbers
    inside_probability: Numbers
    unfamiliar_probability: Numbers


@dataclass(frozen=True, slots=True)
class Rollout:
    """Rollout of one sequence of k pushes.

    Attributes:
        model: model and version that answered.
        steps: the object's pose after each push.
        region_probability: probability that it ends in the region, or None without one.
        particles: (k, p, 3) poses after each push, if they were asked for.
        warnings: reasons not to rely on some pushes. The rows of each are pushes, or sequences of ``rollouts``.
    """

    model: ModelVersionBody
    steps: Steps
    region_probability: float | None
    particles: Numbers | None
    warnings: tuple[BatchWarningBody, ...]


@dataclass(frozen=True, slots=True)
class PushMap:
    """Push map of one object: n pushes from all around it, in its frame.

    Attributes:
        model: model and version that answered.
        pushers: (n, 3) x, y, angle of the tip before each push, in m, m, rad.
        points: (n, 2) place of the outline where each starts, in m.
        length: of every push, in m.
        mean: (n, 3) x, y, angle of the object after each push.
        std: (n, 3) standard deviations of them.
        contact: (n,) whether each push touches the object.
        effectiveness: (n,) motion of the object's points, as root mean square, over the length of the push.
        uncertainty: (n,) standard deviation of where they end, as root mean square, in m.
        warnings: reasons not to rely on some pushes.
    """

    model: ModelVersionBody
    pushers: Numbers
    points: Numbers
    length: float
    mean: Numbers
    std: Numbers
    contact: npt.NDArray[np.bool_]
    effectiveness: Numbers
    uncertainty: Numbers
    warnings: tuple[BatchWarningBody, ...]


def rollout(
    pushes: npt.ArrayLike,
    context: Context | None,
    object_pose: npt.ArrayLike,
    region: Region | None,
    particles: int | None,
    seed: int,
    model: str | None,
    return_particles: bool,
) -> Call[Rollout]:
    """Build the request for one sequence of pushes."""
    rows = push_documents(pushes, "pushes")
    document = _question(context, object_pose, region, particles, seed, model, return_particles) | {"pushes": rows}

    def read(content: bytes) -> Rollout:
        """Return the answer as arrays."""
        body = RolloutResponse.model_validate_json(content, extra="ignore")
        return _rollout(body, body.model, len(rows), check_warnings(body.warnings, len(rows)))

    return post("/v1/rollout", document, read, _bytes(len(rows), return_particles))


def rollouts(
    sequences: Sequence[npt.ArrayLike],
    context: Context | None,
    object_pose: npt.ArrayLike,
    region: Region | None,
    particles: int | None,
    seed: int,
    model: str | None,
) -> Call[tuple[Rollout, ...]]:
    """Build the request for many candidate sequences of pushes."""
    rows = [push_documents(sequence, f"sequences.{number}") for number, sequence in enumerate(sequences)]
    document = _question(context, object_pose, region, particles, seed, model, False) | {"sequences": rows}

    def read(content: bytes) -> tuple[Rollout, ...]:
        """Return the answers as arrays, each with the warnings about it."""
        body = RolloutsResponse.model_validate_json(content, extra="ignore")
        if len(body.sequences) != len(rows):
            raise UnreadableAnswerError(f"the answer has {len(body.sequences)} sequences; expected {len(rows)}")
        warnings = check_warnings(body.warnings, len(rows))
        about = [tuple(warning for warning in warnings if number in warning.rows) for number in range(len(rows))]
        answers = zip(body.sequences, rows, about, strict=True)
        return tuple(_rollout(found, body.model, len(sequence), of_it) for found, sequence, of_it in answers)

    return post("/v1/rollout", document, read, _bytes(sum(map(len, rows)), False))


def push_map(
    context: Context, spacing: float | None, angles: npt.ArrayLike | None, length: float | None, model: str | None
) -> Call[PushMap]:
    """Build the request for a push map."""
    document = {"context": context_document(context), **model_field(model)}
    given = {"spacing": spacing, "angles": angles, "length": length}
    document |= {name: finite_array(value, name).tolist() for name, value in given.items() if value is not None}
    return post("/v1/push-map", document, _push_map, MAX_ANSWER_BYTES + MAX_PUSHES * _STEP_BYTES)


def _push_map(content: bytes) -> PushMap:
    """Return a push map as arrays."""
    body = PushMapResponse.model_validate_json(content, extra="ignore")
    count = len(body.pushers)
    rows = (body.pushers, 3), (body.points, 2), (body.mean, 3), (body.std, 3)
    pushers, points, mean, std = (answer_array(found, (count, width), np.float64) for found, width in rows)
    effectiveness, uncertainty = (
        answer_array(found, (count,), np.float64) for found in (body.effectiveness, body.uncertainty)
    )
    if len(body.contact) != count:
        raise UnreadableAnswerError(f"the answer has {len(body.contact)} contacts; expected {count}")
    contact, warnings = np.array(body.contact, dtype=np.bool_), check_warnings(body.warnings, count)
    return PushMap(body.model, pushers, points, body.length, mean, std, contact, effectiveness, uncertainty, warnings)


def push_documents(pushes: npt.ArrayLike, where: str) -> list[dict[str, float]]:
    """Return the documents of pushes (k, 3) x, y, angle, or (k, 4) with lengths.

    Raises:
        ProblemError: they have another shape, or a number is not finite.
    """
    rows = finite_array(pushes, where)
    if rows.ndim != 2 or rows.shape[1] not in (POSE_PARTS, POSE_PARTS + 1):
        accepted = "shape (k, 3): x and y in m, angle in rad, or (k, 4) with the length in m"
        raise ProblemError.at(where, f"shape {rows.shape}", accepted)
    return [dict(zip(("x", "y", "angle", "length"), row, strict=False)) for row in rows.tolist()]


def read_steps(steps: Sequence[StepBody], count: int) -> Steps:
    """Return the steps of a sequence of ``count`` pushes as arrays.

    Raises:
        UnreadableAnswerError: there are more or fewer, or an array has another shape.
    """
    shares = [[step.miss_probability, step.inside_probability, step.unfamiliar_probability] for step in steps]
    if not count:
        return Steps(np.zeros((0, 3)), np.zeros((0, 3, 3)), *np.zeros((3, 0)))
    found = answer_array(shares, (count, 3), np.float64)
    return Steps(
        answer_array([[step.mean.x, step.mean.y, step.mean.angle] for step in steps], (count, 3), np.float64),
        answer_array([step.covariance for step in steps], (count, 3, 3), np.float64),
        found[:, 0],
        found[:, 1],
        found[:, 2],
    )


def object_question(context: Context | None, object_pose: npt.ArrayLike, model: str | None) -> dict[str, Any]:
    """Return the fields of a question about one object."""
    document = {"object_pose": pose_document(object_pose, "object_pose"), **model_field(model)}
    return document if context is None else document | {"context": context_document(context)}


def _question(
    context: Context | None,
    object_pose: npt.ArrayLike,
    region: Region | None,
    particles: int | None,
    seed: int,
    model: str | None,
    return_particles: bool,
) -> dict[str, Any]:
    document = object_question(context, object_pose, model) | {"seed": seed}
    if region is not None:
        document["region"] = region.document()
    if particles is not None:
        document["particles"] = particles
    return document | {"return_particles": True} if return_particles else document


def _bytes(pushes: int, return_particles: bool) -> int:
    particles = MOST_RETURNED * _PARTICLE_BYTES if return_particles else 0
    return MAX_ANSWER_BYTES + pushes * _STEP_BYTES + particles


def _rollout(
    body: SequenceBody, model: ModelVersionBody, count: int, warnings: tuple[BatchWarningBody, ...]
) -> Rollout:
    particles = body.particles
    if particles is not None:
        width = len(particles[0]) if particles else 0
        returned = answer_array(particles, (count, width, POSE_PARTS), np.float64)
    return Rollout(
        model, read_steps(body.steps, count), body.region_probability, None if particles is None else returned, warnings
    )
