"""Bodies of rollouts: pushes of one object in the world, and its pose after each of them."""

from typing import Annotated, Final

import numpy as np
from pydantic import Field

from service.errors import FieldFault, InvalidRequestError
from service.planning.particles import Region
from service.planning.rollout import MOST_ROWS, MOST_STEPS
from service.pushing.poses import DoubleArray, into_object_frame, unreachable, wrap_angle
from service.schemas.body import Body, at_most
from service.schemas.contexts import ContextBody
from service.schemas.models import ModelVersionBody
from service.schemas.predictions import BatchWarningBody, MeanBody
from service.schemas.pushes import ObjectPoseBody, Prediction, PusherBody
from service.schemas.rows import MAX_PUSHES
from service.schemas.shapes import OUTLINE_EXAMPLE
from service.validity.codes import Angles

MOST_PARTICLES: Final = 1024
USUAL_PARTICLES: Final = 256
MOST_RETURNED: Final = 50_000  # particles in one answer, which are 3 MB
POSE_EXAMPLE: Final = {"x": 0.4, "y": 0.1, "angle": 0.0}
PUSH_EXAMPLE: Final = {"x": 0.32, "y": 0.1, "angle": 0.0, "length": 0.05}
REGION_EXAMPLE: Final = {"x": 0.45, "y": 0.12, "angle": 0.2, "position_tolerance": 0.02, "angle_tolerance": 0.3}
_COVARIANCE_EXAMPLE: Final = [[4e-6, 0.0, 0.0], [0.0, 1e-6, 0.0], [0.0, 0.0, 4e-4]]
STEP_EXAMPLE: Final = {
    "mean": {"x": 0.43, "y": 0.1, "angle": 0.0},
    "covariance": _COVARIANCE_EXAMPLE,
    "miss_probability": 0.0,
    "inside_probability": 0.0,
    "unfamiliar_probability": 0.0,
}
Share = Annotated[float, Field(ge=0, le=1)]


class RegionBody(Body):
    """Region of poses in the world: a disc around a place, and an interval around an angle."""

    x: Annotated[float, Field(ge=-1e6, le=1e6, description="x of the middle, in m", examples=[0.45])]
    y: Annotated[float, Field(ge=-1e6, le=1e6, description="y of the middle, in m", examples=[0.1])]
    angle: Annotated[float, Field(description="angle of the middle, in rad, wrapped to (-pi, pi]", examples=[0.0])]
    position_tolerance: Annotated[float, Field(gt=0, le=10, description="radius of the disc, in m", examples=[0.01])]
    angle_tolerance: Annotated[
        float, Field(gt=0, le=7, description="half of the interval of angles, in rad. pi or more: any", examples=[0.17])
    ]

    def region(self) -> Region:
        """Return the region."""
        pose = (self.x, self.y, wrap_angle(self.angle))
        return Region(pose, self.position_tolerance, self.angle_tolerance)


class ObjectQuestion(Prediction):
    """Base of questions about one object at a known pose in the world."""

    context: Annotated[
        ContextBody | None,
        Field(
            description="the object. Leave it out for models without context.",
            examples=[{"outline": OUTLINE_EXAMPLE}, {"descriptor": "1a2b3c4a"}],
        ),
    ] = None
    object_pose: Annotated[
        ObjectPoseBody,
        Field(description="the object's pose in the world before the first push", examples=[POSE_EXAMPLE]),
    ]

    def start(self) -> DoubleArray:
        """Return the object's pose in the world, (3,)."""
        pose = self.object_pose
        return np.array([pose.x, pose.y, wrap_angle(pose.angle)])


Pushes = Annotated[list[PusherBody], Field(min_length=1, max_length=MOST_STEPS, fail_fast=True), at_most(MOST_STEPS)]


class RolloutRequest(ObjectQuestion):
    """Request for the pose of one object after each of several pushes, or of many candidate sequences of pushes."""

    pushes: Annotated[
        Pushes | None,
        Field(description="the pushes in their order, in the world", examples=[[PUSH_EXAMPLE, PUSH_EXAMPLE]]),
    ] = None
    sequences: Annotated[
        list[Pushes] | None,
        Field(
            min_length=1,
            max_length=MAX_PUSHES,
            fail_fast=True,
            description=f"candidate sequences instead of pushes, with up to {MAX_PUSHES} pushes in all",
            examples=[[[PUSH_EXAMPLE], [PUSH_EXAMPLE, PUSH_EXAMPLE]]],
        ),
        at_most(MAX_PUSHES),
    ] = None
    region: Annotated[
        RegionBody | None,
        Field(description="a region, to be told the probability that the object ends in it", examples=[REGION_EXAMPLE]),
    ] = None
    particles: Annotated[
        int | None,
        Field(
            ge=1,
            le=MOST_PARTICLES,
            description=f"poses that follow the pushes of each sequence. Default: {USUAL_PARTICLES}, or fewer for "
            f"many pushes. Pushes times particles are at most {MOST_ROWS}.",
            examples=[USUAL_PARTICLES],
        ),
    ] = None
    seed: Annotated[
        int,
        Field(ge=0, le=2**32 - 1, description="of the random numbers: the same gives the same answer", examples=[0]),
    ] = 0
    return_particles: Annotated[
        bool,
        Field(description=f"whether the answer has the particles, at most {MOST_RETURNED} in all", examples=[False]),
    ] = False

    def asked_sequences(self) -> list[list[PusherBody]]:
        """Return the sequences, of which there is one if pushes were sent.

        Raises:
            InvalidRequestError: there are neither pushes nor sequences, or both, or too many pushes.
        """
        if (self.pushes is None) == (self.sequences is None):
            received = "neither pushes nor sequences" if self.pushes is None else "pushes and sequences"
            raise InvalidRequestError.at("body", received, "one of them")
        if self.pushes is not None:
            return [self.pushes]
        found = self.sequences or []
        total = sum(map(len, found))
        if total > MAX_PUSHES:
            raise InvalidRequestError.at("body.sequences", f"{total} pushes", f"up to {MAX_PUSHES} in all sequences")
        return found

    def particle_count(self, pushes: int) -> int:
        """Return the number of particles of each of some pushes.

        Raises:
            InvalidRequestError: there are too many for one request, or for one answer.
        """
        count = self.particles or max(1, min(USUAL_PARTICLES, MOST_ROWS // pushes))
        if pushes * count > MOST_ROWS:
            accepted = f"pushes times particles up to {MOST_ROWS}: up to {MOST_ROWS // pushes} particles here"
            raise InvalidRequestError.at("body.particles", f"{count} particles of {pushes} pushes", accepted)
        if self.return_particles and pushes * count > MOST_RETURNED:
            accepted = f"up to {MOST_RETURNED} particles in an answer: up to {MOST_RETURNED // pushes} per push here"
            raise InvalidRequestError.at("body.return_particles", f"true with {count} of {pushes} pushes", accepted)
        return count

    def sent_angles(self) -> Angles:
        """Return every angle of the request as it was sent, by its field. They are judged together."""
        sequences = (self.pushes,) if self.sequences is None else self.sequences
        angles = [push.angle for sequence in sequences if sequence for push in sequence]
        largest = ("pushes" if self.sequences is None else "sequences", (max(angles, key=abs),))
        pose = ("object_pose.angle", (self.object_pose.angle,))
        return (largest, pose) if self.region is None else (largest, pose, ("region.angle", (self.region.angle,)))


def push_rows(pushes: list[PusherBody]) -> DoubleArray:
    """Return pushes (k, 4), x_m, y_m, angle_rad, length_m, their angles wrapped."""
    return np.array([[push.x, push.y, wrap_angle(push.angle), push.length] for push in pushes])


def check_reach(pushes: DoubleArray, start: DoubleArray, reach_m: float, where: str) -> None:
    """Refuse pushes (k, 4) in the world that are out of reach of the object's pose (3,) before the first push.

    Raises:
        InvalidRequestError: names the first.
    """
    placed = into_object_frame(pushes[:, :3], start[None])[:, :2]
    far = np.abs(placed) > reach_m
    if far.any():
        row, column = (int(place) for place in np.argwhere(far)[0])
        fault = unreachable(f"{where}.{row}", float(placed[row, column]), reach_m)
        raise InvalidRequestError([FieldFault(fault.where, fault.received, f"{fault.accepted}, before the first push")])


class StepBody(Body):
    """Pose of the object after one of the pushes: the moments of its particles, and the pushes that go wrong."""

    mean: MeanBody
    covariance: Annotated[
        list[list[float]],
        Field(description="3 x 3, of x, y, angle in m and rad, about the mean", examples=[_COVARIANCE_EXAMPLE]),
    ]
    miss_probability: Annotated[
        Share, Field(description="share of the particles that this push never touches", examples=[0.0])
    ]
    inside_probability: Annotated[
        Share, Field(description="share of the particles that the pusher starts inside of", examples=[0.0])
    ]
    unfamiliar_probability: Annotated[
        Share, Field(description="share of the particles whose push the model does not vouch for", examples=[0.0])
    ]


Steps = Annotated[
    list[StepBody],
    Field(description="after each push, in the world", fail_fast=True, examples=[[STEP_EXAMPLE]]),
]
Probability = Annotated[
    Share | None, Field(description="probability that the object ends in the region, if one was sent", examples=[0.93])
]
Particles = Annotated[
    list[list[Annotated[list[float], Field(fail_fast=True)]]] | None,
    Field(description="x, y, angle of each particle after each push, if they were asked for", examples=[None]),
]


class SequenceBody(Body):
    """Poses of the object after each push of one sequence."""

    steps: Steps
    region_probability: Probability = None
    particles: Particles = None


class RolloutResponse(SequenceBody):
    """Rollout of one sequence of pushes, in the world."""

    model: ModelVersionBody
    frame: Annotated[str, Field(description="frame of every pose: world", examples=["world"])]
    warnings: Annotated[
        list[BatchWarningBody],
        Field(default_factory=list, fail_fast=True, description="of the pushes at ``rows``, from 0", examples=[[]]),
    ]


class RolloutsResponse(Body):
    """Rollouts of candidate sequences of pushes, in the world."""

    model: ModelVersionBody
    frame: Annotated[str, Field(description="frame of every pose: world", examples=["world"])]
    sequences: Annotated[
        list[SequenceBody],
        Field(
            fail_fast=True, description="one for each sequence of the request", examples=[[{"steps": [STEP_EXAMPLE]}]]
        ),
    ]
    warnings: Annotated[
        list[BatchWarningBody],
        Field(default_factory=list, fail_fast=True, description="of the sequences at ``rows``, from 0", examples=[[]]),
    ]
