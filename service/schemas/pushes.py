"""What clients send: the bodies of predictions, to ``contract``. The one place where their JSON meets the domain.

Every field carries its unit, an example and what it means; the OpenAPI document is made of these. The columns of a
batch stop at their first fault: a body with a million faults costs no more than one with one.
"""

from typing import Annotated, Final

import numpy as np
import orjson
from pydantic import FailFast, Field
from pydantic.config import JsonDict

from service.errors import InvalidRequestError, MalformedBodyError
from service.model.reference import ModelReference
from service.model.tensors import IndexArray
from service.pushing.poses import (
    REACH_M,
    WORLD_M,
    DoubleArray,
    _reachable,
    into_object_frame,
    unreachable,
    wrap_angle,
)
from service.schemas.body import Body
from service.schemas.contexts import ContextBody
from service.schemas.rows import MAX_PUSHES, Rows


class PusherBody(Body):
    """The pusher tip's pose before the push, in the object frame, or in the world when ``object_pose`` is given."""

    x: Annotated[
        float,
        Field(
            ge=-WORLD_M,
            le=WORLD_M,
            description="position along the x axis, in m; at most 1 m from the object along its axes",
            examples=[-0.075],
        ),
    ]
    y: Annotated[
        float,
        Field(
            ge=-WORLD_M,
            le=WORLD_M,
            description="position along the y axis, in m; at most 1 m from the object along its axes",
            examples=[0.0],
        ),
    ]
    angle: Annotated[
        float,
        Field(description="direction of the push from the x axis, in rad; any real number, wrapped", examples=[0.0]),
    ]


class ObjectPoseBody(Body):
    """The object's pose in the world, before the push."""

    x: Annotated[float, Field(ge=-WORLD_M, le=WORLD_M, description="of the centre of its core, in m", examples=[0.4])]
    y: Annotated[float, Field(ge=-WORLD_M, le=WORLD_M, description="of the centre of its core, in m", examples=[0.1])]
    angle: Annotated[
        float, Field(description="of its x axis, through the middle of side 1, in rad; wrapped", examples=[1.57])
    ]


# for the document only, like the bounds of rows below: our own words say what is wrong
_PART: Final = "[a-z0-9][a-z0-9_-]{0,63}"
_REFERENCE: Final[JsonDict] = {"pattern": f"^{_PART}(@([a-z][a-z0-9_-]{{0,63}}|[1-9][0-9]{{0,8}}))?$"}
Reference = Annotated[
    str | None,
    Field(
        max_length=140,
        json_schema_extra=_REFERENCE,
        description="name, name@alias or name@version; left out: the champion for this kind of context",
        examples=["push-indicator", "push-indicator@champion", "push-indicator@1"],
    ),
]


class Prediction(Body):
    """What every prediction may ask for."""

    model: Reference = None

    def reference(self) -> ModelReference | None:
        """The model that was asked for.

        Raises:
            InvalidRequestError: the text is no reference.
        """
        return None if self.model is None else ModelReference.parse(self.model, "body.model")


class PredictRequest(Prediction):
    """One push of one object: straight, at constant speed, 50 mm."""

    pusher: PusherBody
    context: Annotated[
        ContextBody | None,
        Field(
            description="the object; left out for models that know nothing of it", examples=[{"descriptor": "1a2b3c4a"}]
        ),
    ] = None
    object_pose: Annotated[
        ObjectPoseBody | None,
        Field(
            description="where the object is in the world; the pusher's pose is then in the world too, and so is the "
            "answer, with its covariance",
            examples=[{"x": 0.4, "y": 0.1, "angle": 1.57}],
        ),
    ] = None

    def objects(self) -> DoubleArray | None:
        """Where the object is in the world, (1, 3), where that was said."""
        pose = self.object_pose
        return None if pose is None else np.array([[pose.x, pose.y, wrap_angle(pose.angle)]])

    def pusher_poses(self) -> DoubleArray:
        """The pusher pose in the object frame, (1, 3), its angle wrapped.

        Raises:
            InvalidRequestError: it is out of reach.
        """
        x, y, angle, objects = self.pusher.x, self.pusher.y, self.pusher.angle, self.objects()
        if objects is None:
            if -REACH_M <= x <= REACH_M and -REACH_M <= y <= REACH_M:
                return np.array([[x, y, wrap_angle(angle)]])
            name, value = ("x", x) if abs(x) > REACH_M else ("y", y)
            raise InvalidRequestError([unreachable(f"body.pusher.{name}", value)])
        return _reachable(into_object_frame(np.array([[x, y, wrap_angle(angle)]]), objects), "body.pusher")


Place = Annotated[int, Field(json_schema_extra={"minimum": 0, "maximum": MAX_PUSHES - 1})]


class BatchRequest(Prediction):
    """Many pushes, of one object or of many, in columns."""

    pushers: Annotated[
        Rows,
        Field(
            description="for each push x, y, angle in m, m, rad: the pusher tip's pose in the object frame, or in the "
            "world when object_poses is given; at most 1 m from the object along its axes; angles are wrapped",
            examples=[[[-0.075, 0.0, 0.0], [0.0, -0.075, 1.5708]]],
        ),
    ]
    contexts: Annotated[
        list[ContextBody] | None,
        FailFast(),
        Field(
            min_length=1,
            max_length=MAX_PUSHES,
            description="the objects: one for all pushes, one per push, or several with context_index; left out for "
            "models that know nothing of them",
            examples=[[{"descriptor": "1a2b3c4a"}]],
        ),
    ] = None
    context_index: Annotated[
        list[Place] | None,
        FailFast(),
        Field(
            min_length=1,
            max_length=MAX_PUSHES,
            description="for each push the place of its object in contexts, from 0; left out when there is one context "
            "or one per push",
            examples=[[0, 0]],
        ),
    ] = None
    object_poses: Annotated[
        Rows | None,
        Field(
            description="x, y, angle in m, m, rad of the object in the world before the push: one for all pushes or "
            "one per push; the pusher poses are then in the world too, and so is the answer, with its covariances",
            examples=[[[0.4, 0.1, 1.57]]],
        ),
    ] = None

    def objects(self) -> DoubleArray | None:
        """Where the objects are in the world, (1, 3) or (n, 3), where that was said.

        Raises:
            InvalidRequestError: neither one nor one per push, or further away than the world goes.
        """
        if self.object_poses is None:
            return None
        if len(self.object_poses) not in (1, len(self.pushers)):
            received, accepted = f"{len(self.object_poses)} poses", f"1, or {len(self.pushers)}: one per push"
            raise InvalidRequestError.at("body.object_poses", received, accepted)
        return _reachable(self.object_poses, "body.object_poses", WORLD_M)

    def pusher_poses(self) -> DoubleArray:
        """The pusher poses in the object frame, (n, 3), their angles wrapped.

        Raises:
            InvalidRequestError: one is out of reach.
        """
        objects = self.objects()
        if objects is None:
            return _reachable(self.pushers, "body.pushers")
        world = _reachable(self.pushers, "body.pushers", WORLD_M)
        return _reachable(into_object_frame(world, objects), "body.pushers")

    def places(self) -> IndexArray:
        """For each push the place of its context, (n,).

        Raises:
            InvalidRequestError: contexts and index do not fit the pushes.
        """
        count, contexts = len(self.pushers), len(self.contexts or ())
        if not contexts:
            raise InvalidRequestError.at("body.contexts", "nothing", "contexts for context_index")
        if self.context_index is None:
            if contexts == 1:
                return np.zeros(count, dtype=np.int64)
            if contexts == count:
                return np.arange(count, dtype=np.int64)
            accepted = f"1, or {count}: one per push, or any number with context_index"
            raise InvalidRequestError.at("body.contexts", f"{contexts} contexts", accepted)
        if len(self.context_index) != count:
            received = f"{len(self.context_index)} values"
            raise InvalidRequestError.at("body.context_index", received, f"{count} values: one per push")
        wrong = next((row for row, place in enumerate(self.context_index) if not 0 <= place < contexts), None)
        if wrong is not None:
            received, accepted = "a place that contexts does not have", f"0 to {contexts - 1}"
            raise InvalidRequestError.at(f"body.context_index.{wrong}", received, accepted)
        return np.array(self.context_index, dtype=np.int64)


def read_batch(content: bytes) -> BatchRequest:
    """A batch from its JSON, by the faster of two readers; what it does not take, the documented way explains.

    Raises:
        MalformedBodyError: it is no JSON, or a number in it is too large.
        ValidationError: it is JSON of another form.
    """
    try:
        document = orjson.loads(content)
    except orjson.JSONDecodeError as error:
        raise MalformedBodyError(f"body: received no JSON ({error}); accepted is JSON in UTF-8") from error
    return BatchRequest.model_validate(document)
