"""Bodies of plans: where an object is and should be, with which pushes, among which obstacles, and the plan."""

from collections.abc import Sequence
from typing import Annotated, Final

import numpy as np
from pydantic import BeforeValidator, Field

from service.errors import InvalidRequestError
from service.planning.candidates import LEAST_GAP_M
from service.planning.particles import Region
from service.planning.plan import CLEARANCE_M, LEAST_TIME_S, MOST_PUSHES, MOST_TIME_S, TIME_S, Reason
from service.planning.surroundings import Surroundings
from service.pushing.outlines import FEWEST_CORNERS, Outline
from service.pushing.poses import MAX_LENGTH_M, PUSH_LENGTH_M, WORLD_M, DoubleArray, wrap_angle
from service.schemas.body import Body, at_most
from service.schemas.contexts import ContextBody
from service.schemas.models import ModelVersionBody
from service.schemas.planning.rollouts import POSE_EXAMPLE, STEP_EXAMPLE, Share, StepBody
from service.schemas.predictions import BatchWarningBody
from service.schemas.pushes import ObjectPoseBody, Prediction, PusherBody
from service.schemas.shapes import OUTLINE_EXAMPLE, listed
from service.validity.codes import Angles

USUAL_PUSHES: Final = 10
USUAL_LENGTHS_M: Final = (0.02, PUSH_LENGTH_M, 0.1)
MOST_LENGTHS: Final = 16
MOST_OBSTACLES: Final = 16
MOST_POLYGON_CORNERS: Final = 64  # of one obstacle, or of the workspace
MOST_CORNERS: Final = 256  # of all of them
EXTENTS_M: Final = (0.001, 20.0)  # of obstacles and workspaces
GOAL_EXAMPLE: Final = {"x": 0.5, "y": 0.15, "angle": 0.6}
WORKSPACE_EXAMPLE: Final = [[0.0, -0.3], [0.8, -0.3], [0.8, 0.4], [0.0, 0.4]]
OBSTACLE_EXAMPLE: Final = [[0.55, -0.1], [0.6, -0.1], [0.6, 0.0], [0.55, 0.0]]
PLANNED_EXAMPLE: Final = {"x": 0.33, "y": 0.11, "angle": 0.1, "length": 0.05}
_Corner = Annotated[
    list[Annotated[float, Field(ge=-WORLD_M, le=WORLD_M)]], Field(min_length=2, max_length=2, fail_fast=True)
]
Corners = Annotated[
    list[_Corner],
    Field(min_length=FEWEST_CORNERS, max_length=MOST_POLYGON_CORNERS, fail_fast=True),
    BeforeValidator(listed),
    at_most(MOST_POLYGON_CORNERS),
]


class PlanRequest(Prediction):
    """Request for pushes that bring one object from a pose to a goal, both in the world."""

    context: Annotated[
        ContextBody,
        Field(
            description="the object: an outline, an image with metres_per_pixel, a descriptor or an indicator",
            examples=[{"outline": OUTLINE_EXAMPLE}, {"descriptor": "1a2b3c4a"}],
        ),
    ]
    object_pose: Annotated[ObjectPoseBody, Field(description="the object's pose now", examples=[POSE_EXAMPLE])]
    goal: Annotated[ObjectPoseBody, Field(description="the pose to bring it to", examples=[GOAL_EXAMPLE])]
    position_tolerance: Annotated[
        float, Field(ge=1e-4, le=1, description="distance from the goal that is near enough, in m", examples=[0.01])
    ] = 0.01
    angle_tolerance: Annotated[
        float,
        Field(ge=1e-3, le=7, description="turn from the goal that is small enough, in rad. 7: any.", examples=[0.17]),
    ] = 0.17
    max_pushes: Annotated[
        int, Field(ge=1, le=MOST_PUSHES, description="most pushes of the plan", examples=[USUAL_PUSHES])
    ] = USUAL_PUSHES
    lengths: Annotated[
        list[Annotated[float, Field(gt=LEAST_GAP_M, le=MAX_LENGTH_M)]] | None,
        Field(
            min_length=1,
            max_length=MOST_LENGTHS,
            fail_fast=True,
            description="lengths that a push may have, in m. The tip starts at least 3 mm before the object. Default: "
            "0.02, 0.05 and 0.1, or 0.05 for models that know no other.",
            examples=[list(USUAL_LENGTHS_M)],
        ),
        at_most(MOST_LENGTHS),
    ] = None
    workspace: Annotated[
        Corners | None,
        Field(
            description=f"corners [x, y] in m of the polygon that object and tip stay in, up to {MOST_POLYGON_CORNERS}",
            examples=[WORKSPACE_EXAMPLE],
        ),
    ] = None
    obstacles: Annotated[
        list[Corners],
        Field(
            max_length=MOST_OBSTACLES,
            fail_fast=True,
            description="polygons that neither object nor tip touches, each by its corners [x, y] in m. All of them "
            f"and the workspace have up to {MOST_CORNERS} corners.",
            examples=[[OBSTACLE_EXAMPLE]],
        ),
        at_most(MOST_OBSTACLES),
    ] = []  # noqa: RUF012 (pydantic copies it)
    clearance: Annotated[
        float,
        Field(
            ge=0.002,
            le=0.1,
            description="distance that object and tip keep from obstacles and from the edge of the workspace, in m",
            examples=[CLEARANCE_M],
        ),
    ] = CLEARANCE_M
    time_s: Annotated[
        float,
        Field(
            ge=LEAST_TIME_S,
            le=MOST_TIME_S,
            description="time budget in s. It decides how many pushes are considered, so that the same budget and seed "
            "give the same plan, and stops the search when it is over.",
            examples=[TIME_S],
        ),
    ] = TIME_S
    seed: Annotated[
        int, Field(ge=0, le=2**32 - 1, description="of the random numbers of the probabilities", examples=[0])
    ] = 0

    def start(self) -> DoubleArray:
        """Return the object's pose in the world, (3,)."""
        pose = self.object_pose
        return np.array([pose.x, pose.y, wrap_angle(pose.angle)])

    def region(self) -> Region:
        """Return the region of poses that reach the goal."""
        pose = self.goal.x, self.goal.y, wrap_angle(self.goal.angle)
        return Region(pose, self.position_tolerance, self.angle_tolerance)

    def surroundings(self) -> Surroundings:
        """Return workspace and obstacles.

        Raises:
            InvalidRequestError: a polygon is none, or there are too many corners. Names it.
        """
        total = sum(map(len, self.obstacles)) + len(self.workspace or ())
        if total > MOST_CORNERS:
            accepted = f"up to {MOST_CORNERS} of all obstacles and the workspace"
            raise InvalidRequestError.at("body.obstacles", f"{total} corners", accepted)
        workspace = None if self.workspace is None else _polygon(self.workspace, "body.workspace")
        obstacles = tuple(
            _polygon(corners, f"body.obstacles.{number}") for number, corners in enumerate(self.obstacles)
        )
        around = np.array([[self.object_pose.x, self.object_pose.y], [self.goal.x, self.goal.y]])
        return Surroundings(workspace, obstacles, around)

    def sent_angles(self) -> Angles:
        """Return every angle of the request as it was sent, by its field."""
        return ("object_pose.angle", (self.object_pose.angle,)), ("goal.angle", (self.goal.angle,))


def _polygon(corners: Sequence[Sequence[float]], where: str) -> Outline:
    return Outline.of(corners, where, EXTENTS_M)


class PlanStepBody(StepBody):
    """Pose of the object after one of the pushes of a plan."""

    collision_probability: Annotated[
        Share,
        Field(
            description="share of the particles of which object or tip touches an obstacle, or leaves the workspace, "
            "up to this push",
            examples=[0.0],
        ),
    ]


class ReasonBody(Body):
    """Reason why there is no plan."""

    code: Annotated[Reason, Field(description="stable code of the reason", examples=[Reason.OUT_OF_REACH])]
    detail: Annotated[
        str,
        Field(
            description="the reason in words, with its figures",
            examples=["no sequence of at most 3 pushes ends within the tolerance: the best ends 32 mm and 12 deg off"],
        ),
    ]


class PlanResponse(Body):
    """Plan, in the world, or the reason why there is none. Make its first push, look, and plan again."""

    model: ModelVersionBody
    frame: Annotated[str, Field(description="frame of every pose: world", examples=["world"])]
    pushes: Annotated[
        list[PusherBody],
        Field(
            fail_fast=True,
            description="the pushes in their order. Empty at the goal, and if there is a reason.",
            examples=[[PLANNED_EXAMPLE]],
        ),
    ]
    steps: Annotated[
        list[PlanStepBody],
        Field(
            fail_fast=True,
            description="after each push, if all are made without looking",
            examples=[[{**STEP_EXAMPLE, "collision_probability": 0.0}]],
        ),
    ]
    goal_probability: Annotated[
        Share,
        Field(description="probability of ending in the goal if all are made without looking", examples=[0.4]),
    ]
    replanned_probability: Annotated[
        Share,
        Field(
            description="probability that the last push ends in the goal if the plan is renewed after each push before",
            examples=[0.8],
        ),
    ]
    reason: Annotated[ReasonBody | None, Field(description="why there is no plan, or null", examples=[None])] = None
    stopped: Annotated[
        bool,
        Field(
            description="whether the time budget was over before the work was done: another call may give another plan",
            examples=[False],
        ),
    ]
    warnings: Annotated[
        list[BatchWarningBody],
        Field(default_factory=list, fail_fast=True, description="of the pushes at ``rows``, from 0", examples=[[]]),
    ]
