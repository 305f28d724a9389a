"""Bodies of prediction requests, and their conversion to arrays of the domain.

The columns of a batch stop at their first fault, so a body with a million faults costs no more than a body with one.
"""

from typing import Annotated, Any, Final

import numpy as np
from pydantic import BeforeValidator, FailFast, Field
from pydantic.config import JsonDict

from service.errors import InvalidRequestError
from service.model.reference import ALIAS_PATTERN, NAME_PATTERN, VERSION_PATTERN, ModelReference
from service.model.tensors import IndexArray
from service.pushing.contexts import index_contexts
from service.pushing.poses import (
    MAX_LENGTH_M,
    PUSH_LENGTH_M,
    REACH_M,
    WORLD_M,
    DoubleArray,
    into_object_frame,
    reachable,
    unreachable,
    wrap_angle,
)
from service.schemas.body import Body, at_most
from service.schemas.contexts import ContextBody
from service.schemas.rows import MAX_PUSHES, Rows
from service.schemas.shapes import OUTLINE_EXAMPLE
from service.validity.codes import Angles

_USUAL_LENGTH_M: Final = np.array([PUSH_LENGTH_M])
_USUAL_LENGTH_M.setflags(write=False)


class PusherBody(Body):
    """Push: pose of the pusher's tip before it, in the object frame, or in the world with ``object_pose``; length."""

    x: Annotated[
        float,
        Field(
            ge=-WORLD_M,
            le=WORLD_M,
            description="position along the x axis, in m, at most 1 m from the object along its axes",
            examples=[-0.075],
        ),
    ]
    y: Annotated[
        float,
        Field(
            ge=-WORLD_M,
            le=WORLD_M,
            description="position along the y axis, in m, at most 1 m from the object along its axes",
            examples=[0.0],
        ),
    ]
    angle: Annotated[
        float,
        Field(
            description="direction of the push from the x axis, in rad. Any real number, wrapped to (-pi, pi].",
            examples=[0.0],
        ),
    ]
    length: Annotated[
        float,
        Field(
            gt=0.0,
            le=MAX_LENGTH_M,
            description="length of the push, in m. Models of any shape know every length, others 0.05 only.",
            examples=[PUSH_LENGTH_M],
        ),
    ] = PUSH_LENGTH_M


class ObjectPoseBody(Body):
    """Pose of the object in the world, before the push."""

    x: Annotated[float, Field(ge=-WORLD_M, le=WORLD_M, description="x of the centre of the core, in m", examples=[0.4])]
    y: Annotated[float, Field(ge=-WORLD_M, le=WORLD_M, description="y of the centre of the core, in m", examples=[0.1])]
    angle: Annotated[
        float,
        Field(
            description="direction of the object's x axis (through the middle of side 1), in rad, wrapped to (-pi, pi]",
            examples=[1.57],
        ),
    ]


# Schema of the OpenAPI document only. ``ModelReference`` has the better error messages.
_REFERENCE: Final[JsonDict] = {"pattern": f"^{NAME_PATTERN}(@({ALIAS_PATTERN}|{VERSION_PATTERN}))?$"}
Reference = Annotated[
    str | None,
    Field(
        max_length=140,
        json_schema_extra=_REFERENCE,
        description="the model: name, name@alias or name@version. Default: the champion for this kind of context.",
        examples=["push-indicator", "push-indicator@champion", "push-indicator@1"],
    ),
]


class Prediction(Body):
    """Base of the prediction requests: the fields that all of them have."""

    model: Reference = None

    def reference(self) -> ModelReference | None:
        """Return the reference to the model, if one was sent.

        Raises:
            InvalidRequestError: the field is not a reference.
        """
        return None if self.model is None else ModelReference.parse(self.model, "body.model")


class PredictRequest(Prediction):
    """Request for one push of one object: straight, at constant speed, 50 mm unless ``length`` says otherwise."""

    pusher: PusherBody
    context: Annotated[
        ContextBody | None,
        Field(
            description="the object. Leave it out for models without context.",
            examples=[{"descriptor": "1a2b3c4a"}, {"outline": OUTLINE_EXAMPLE}],
        ),
    ] = None
    object_pose: Annotated[
        ObjectPoseBody | None,
        Field(
            description="the object's pose in the world. If it is given, the pusher's pose is in the world too, and so "
            "is the answer, with its covariance.",
            examples=[{"x": 0.4, "y": 0.1, "angle": 1.57}],
        ),
    ] = None

    def object_frames(self) -> DoubleArray | None:
        """Return the object's pose in the world, (1, 3), or None if it was not sent."""
        pose = self.object_pose
        return None if pose is None else np.array([[pose.x, pose.y, wrap_angle(pose.angle)]])

    def sent_angles(self) -> Angles:
        """Return every angle of the request as it was sent, by its field."""
        pusher = ("pusher.angle", (self.pusher.angle,))
        pose = self.object_pose
        return (pusher,) if pose is None else (pusher, ("object_pose.angle", (pose.angle,)))

    def pusher_poses(self, reach_m: float = REACH_M) -> DoubleArray:
        """Return the pusher pose in the object frame, (1, 3), its angle wrapped.

        Raises:
            InvalidRequestError: the pusher is out of reach.
        """
        x, y, angle, frames = self.pusher.x, self.pusher.y, self.pusher.angle, self.object_frames()
        if frames is None:
            if -reach_m <= x <= reach_m and -reach_m <= y <= reach_m:
                return np.array([[x, y, wrap_angle(angle)]])
            name, value = ("x", x) if abs(x) > reach_m else ("y", y)
            raise InvalidRequestError([unreachable(f"body.pusher.{name}", value, reach_m)])
        return reachable(into_object_frame(np.array([[x, y, wrap_angle(angle)]]), frames), "body.pusher", reach_m)

    def lengths_m(self) -> DoubleArray:
        """Return the length of the push, (1,)."""
        return _USUAL_LENGTH_M if self.pusher.length == PUSH_LENGTH_M else np.array([self.pusher.length])


_Length = Annotated[float, Field(gt=0.0, le=MAX_LENGTH_M)]


def _listed(found: Any) -> Any:
    """Return a number as a list of one."""
    return found if isinstance(found, list) else [found]


def _one_or_many(schema: dict[str, Any]) -> None:
    """Add to the schema that one number is accepted as well as a list."""
    form = {name: schema.pop(name) for name in ("type", "items", "minItems", "maxItems")}
    schema |= {"anyOf": [form["items"], form], "default": PUSH_LENGTH_M}


ContextIndex = Annotated[int, Field(json_schema_extra={"minimum": 0, "maximum": MAX_PUSHES - 1})]


class PushColumns(Prediction):
    """Pushes in columns: poses, lengths, and the poses of their objects."""

    pushers: Annotated[
        Rows,
        Field(
            description="for each push x, y, angle in m, m, rad: the pose of the pusher's tip in the object frame, or "
            "in the world when object_poses is given. At most 1 m from the object along its axes. Angles are wrapped.",
            examples=[[[-0.075, 0.0, 0.0], [0.0, -0.075, 1.5708]]],
        ),
    ]
    lengths: Annotated[
        list[_Length],
        Field(
            min_length=1,
            max_length=MAX_PUSHES,
            fail_fast=True,
            description="length of every push, or one per push, in m. Models of any shape know every length, others "
            "0.05 only.",
            examples=[PUSH_LENGTH_M, [0.05, 0.02]],
            json_schema_extra=_one_or_many,
        ),
        BeforeValidator(_listed),
        at_most(MAX_PUSHES),
    ] = [PUSH_LENGTH_M]  # noqa: RUF012 (pydantic copies it)
    object_poses: Annotated[
        Rows | None,
        Field(
            description="x, y, angle in m, m, rad of the object in the world before the push: one for all pushes, or "
            "one per push. If they are given, the pusher poses are in the world too, and so is the answer, with its "
            "covariances.",
            examples=[[[0.4, 0.1, 1.57]]],
        ),
    ] = None

    def object_frames(self) -> DoubleArray | None:
        """Return the objects' poses in the world, (1, 3) or (n, 3), or None if they were not sent.

        Raises:
            InvalidRequestError: there is neither one pose nor one per push, or a coordinate is over ``WORLD_M``.
        """
        if self.object_poses is None:
            return None
        if len(self.object_poses) not in (1, len(self.pushers)):
            received, accepted = f"{len(self.object_poses)} poses", f"1 pose, or {len(self.pushers)}: one per push"
            raise InvalidRequestError.at("body.object_poses", received, accepted)
        return reachable(self.object_poses, "body.object_poses", WORLD_M)

    def sent_angles(self) -> Angles:
        """Return every angle of the request as it was sent, by its field: one, or one per push."""
        fields = (("pushers", self.pushers), ("object_poses", self.object_poses))
        return tuple((name, rows[:, 2]) for name, rows in fields if rows is not None)

    def pusher_poses(self, reach_m: float = REACH_M) -> DoubleArray:
        """Return the pusher poses in the object frame, (n, 3), their angles wrapped.

        Raises:
            InvalidRequestError: a pusher is out of reach.
        """
        frames = self.object_frames()
        if frames is None:
            return reachable(self.pushers, "body.pushers", reach_m)
        world = reachable(self.pushers, "body.pushers", WORLD_M)
        return reachable(into_object_frame(world, frames), "body.pushers", reach_m)

    def lengths_m(self) -> DoubleArray:
        """Return the lengths of the pushes, (1,) for all of them, or (n,).

        Raises:
            InvalidRequestError: there is neither one length nor one per push.
        """
        lengths = np.array(self.lengths)
        if len(lengths) not in (1, len(self.pushers)):
            accepted = f"one number, or {len(self.pushers)}: one per push"
            raise InvalidRequestError.at("body.lengths", f"{len(lengths)} lengths", accepted)
        return lengths


class BatchRequest(PushColumns):
    """Request for many pushes, of one object or of many, in columns."""

    contexts: Annotated[
        list[ContextBody] | None,
        FailFast(),
        Field(
            min_length=1,
            max_length=MAX_PUSHES,
            description="the objects: one for all pushes, one per push, or several with context_index. Leave them out "
            "for models without context.",
            examples=[[{"descriptor": "1a2b3c4a"}], [{"outline": OUTLINE_EXAMPLE}]],
        ),
    ] = None
    context_index: Annotated[
        list[ContextIndex] | None,
        FailFast(),
        Field(
            min_length=1,
            max_length=MAX_PUSHES,
            description="for each push the index of its object in contexts, from 0. Leave it out with one context, or "
            "with one per push.",
            examples=[[0, 0]],
        ),
    ] = None

    def context_indices(self) -> IndexArray | None:
        """Return the index of each push's context, (n,), or None if neither contexts nor an index were sent.

        Raises:
            InvalidRequestError: contexts and index do not fit the pushes.
        """
        if self.contexts is None and self.context_index is None:
            return None
        if not self.contexts:
            raise InvalidRequestError.at("body.contexts", "no contexts", "the contexts that context_index refers to")
        fields = ("body.contexts", "body.context_index")
        return index_contexts(len(self.contexts), len(self.pushers), self.context_index, fields)
