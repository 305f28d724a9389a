"""Request and response bodies, to and from ``contract``: the one place where JSON meets the domain.

Every field carries its unit, an example and what it means; the OpenAPI document is made of these.
"""

from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from service.contract import INDICATOR_LENGTH, GaussianPose, ObjectContext, Pose
from service.errors import FieldFault, InvalidRequestError
from service.manifest import ModelReference

REACH_M = 1.0  # a push is 50 mm: further from the object nothing can touch it
_INDICATOR_EXAMPLE = ObjectContext.from_descriptor("1a2b3c4a").indicator().astype(int).tolist()

_MODEL_EXAMPLE = {
    "name": "push-indicator",
    "method": "FCN + CM + L2Reg",
    "context_kind": "indicator",
    "versions": [1, 2],
    "aliases": {"champion": 2},
}
_FAULT_EXAMPLE = {
    "where": "body.context.indicator side 3",
    "received": "2 shapes (1, 4)",
    "accepted": "exactly one shape of 1, 2, 3, 4",
}
_DETAIL_EXAMPLE = "{where}: received {received}; accepted is {accepted}".format(**_FAULT_EXAMPLE)


class _Body(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False, frozen=True)


class PusherBody(_Body):
    """The pusher tip's pose in the object frame, before the push."""

    x: Annotated[
        float, Field(ge=-REACH_M, le=REACH_M, description="position along the object's x axis, in m", examples=[-0.075])
    ]
    y: Annotated[
        float, Field(ge=-REACH_M, le=REACH_M, description="position along the object's y axis, in m", examples=[0.0])
    ]
    angle: Annotated[
        float,
        Field(
            description="direction of the push from the object's x axis, in rad; any real number, wrapped",
            examples=[0.0],
        ),
    ]


class ContextBody(_Body):
    """What is known of the object: its descriptor or its indicator, exactly one of them."""

    descriptor: Annotated[
        str | None,
        Field(
            description="four sides, each a shape digit (1 concave, 2 triangular, 3 circular, 4 rectangular) and a "
            "weight letter (a none, b 60 g, c 150 g; B 60 g, C 150 g in a triangle's second position)",
            examples=["1a2b3c4a"],
        ),
    ] = None
    indicator: Annotated[
        list[float] | None,
        Field(
            min_length=INDICATOR_LENGTH,
            max_length=INDICATOR_LENGTH,
            description="36 zeros and ones: for each of four sides the shape one-hot (4), then the weight one-hot (5)",
            examples=[_INDICATOR_EXAMPLE],
        ),
    ] = None

    def to_contract(self) -> ObjectContext:
        """The object.

        Raises:
            InvalidRequestError: not exactly one form, or a side that cannot be one.
        """
        if self.descriptor is not None and self.indicator is None:
            return ObjectContext.from_descriptor(self.descriptor, "body.context.descriptor")
        if self.indicator is not None and self.descriptor is None:
            return ObjectContext.from_indicator(self.indicator, "body.context.indicator")
        received = "neither" if self.descriptor is None else "both"
        raise InvalidRequestError([FieldFault("body.context", received, "exactly one of descriptor and indicator")])


class PredictRequest(_Body):
    """One push of one object: straight, at constant speed, 50 mm."""

    model_config = ConfigDict(
        extra="forbid",
        strict=True,
        allow_inf_nan=False,
        frozen=True,
        json_schema_extra={
            "examples": [
                {"pusher": {"x": -0.075, "y": 0.0, "angle": 0.0}, "context": {"descriptor": "1a2b3c4a"}},
            ]
        },
    )

    pusher: PusherBody
    context: Annotated[
        ContextBody | None,
        Field(
            description="the object; left out for models that know nothing of it", examples=[{"descriptor": "1a2b3c4a"}]
        ),
    ] = None
    model: Annotated[
        str | None,
        Field(
            max_length=140,
            description="name, name@alias or name@version; left out: the champion for this kind of context",
            examples=["push-indicator", "push-indicator@champion", "push-indicator@1"],
        ),
    ] = None

    def reference(self) -> ModelReference | None:
        """The model that was asked for.

        Raises:
            InvalidRequestError: the text is no reference.
        """
        return None if self.model is None else ModelReference.parse(self.model, "body.model")

    def object_context(self) -> ObjectContext | None:
        """The object, where one was given.

        Raises:
            InvalidRequestError: not exactly one form, or a side that cannot be one.
        """
        return None if self.context is None else self.context.to_contract()

    def push(self) -> Pose:
        """The pusher pose, its angle wrapped."""
        return Pose.wrapped(self.pusher.x, self.pusher.y, self.pusher.angle)


class ModelVersionBody(_Body):
    """Which model answered."""

    name: Annotated[str, Field(description="name in the registry", examples=["push-indicator"])]
    version: Annotated[int, Field(ge=1, description="version, immutable", examples=[1])]


class MeanBody(_Body):
    """Expected pose of the object after the push, in the object frame before it."""

    x: Annotated[float, Field(description="in m", examples=[0.021])]
    y: Annotated[float, Field(description="in m", examples=[0.001])]
    angle: Annotated[float, Field(description="in rad, in (-pi, pi]", examples=[0.03])]


class StdBody(_Body):
    """Standard deviation of that pose; the three are independent."""

    x: Annotated[float, Field(gt=0, description="in m", examples=[0.002])]
    y: Annotated[float, Field(gt=0, description="in m", examples=[0.001])]
    angle: Annotated[float, Field(gt=0, description="in rad", examples=[0.02])]


class PredictResponse(_Body):
    """A Gaussian over the object's pose after the push."""

    model: ModelVersionBody
    frame: Annotated[Literal["object"], Field(description="the object's pose before the push", examples=["object"])] = (
        "object"
    )
    mean: MeanBody
    std: StdBody

    @classmethod
    def of(cls, name: str, version: int, gaussian: GaussianPose) -> "PredictResponse":
        """The answer of a model version; its numbers are finite by the predictor's own check: none is checked again."""
        mean, std = gaussian.mean, gaussian.std
        return cls.model_construct(
            model=ModelVersionBody.model_construct(name=name, version=version),
            frame="object",
            mean=MeanBody.model_construct(x=mean.x_m, y=mean.y_m, angle=mean.angle_rad),
            std=StdBody.model_construct(x=std.x_m, y=std.y_m, angle=std.angle_rad),
        )


class ModelBody(_Body):
    """A model as it is served now."""

    name: Annotated[str, Field(description="name in the registry", examples=["push-indicator"])]
    method: Annotated[str, Field(description="row of the paper's tables", examples=["FCN + CM + L2Reg"])]
    context_kind: Annotated[str, Field(description="what it wants to know of the object", examples=["indicator"])]
    versions: Annotated[list[int], Field(description="versions served, oldest first", examples=[[1, 2]])]
    aliases: Annotated[dict[str, int], Field(description="what each alias means", examples=[{"champion": 2}])]


class ModelsBody(_Body):
    """Every model that is served."""

    models: Annotated[list[ModelBody], Field(description="sorted by name", examples=[[_MODEL_EXAMPLE]])]


class ModelVersionDetailBody(_Body):
    """One version: its manifest and its card."""

    name: Annotated[str, Field(description="name in the registry", examples=["push-indicator"])]
    version: Annotated[int, Field(ge=1, description="version, immutable", examples=[1])]
    aliases: Annotated[list[str], Field(description="aliases that mean this version now", examples=[["champion"]])]
    manifest: Annotated[
        dict[str, Any],
        Field(
            description="manifest.json as published: method, data, metrics, tensors with units, digests",
            examples=[{"format": 1, "name": "push-indicator", "version": 1, "method": "FCN + CM + L2Reg"}],
        ),
    ]
    card: Annotated[str, Field(description="the model card, Markdown", examples=["# push-indicator\n"])]


class LiveBody(_Body):
    """The process answers."""

    live: Annotated[Literal[True], Field(description="always true", examples=[True])] = True


class ReadyBody(_Body):
    """Whether predictions can be answered, and what is wrong with the registry where something is."""

    ready: Annotated[bool, Field(description="at least one model passed all checks and is served", examples=[True])]
    models: Annotated[dict[str, list[int]], Field(description="versions served", examples=[{"push-indicator": [1]}])]
    problems: Annotated[
        list[str],
        Field(
            description="why something published is not served; what was served before goes on being served",
            examples=[["push-indicator@2 is broken and not served: model.onnx: the sha256 differs"]],
        ),
    ]


class FaultBody(_Body):
    """One fault in a request."""

    where: Annotated[str, Field(description="the field", examples=["body.context.indicator side 3"])]
    received: Annotated[str, Field(description="what came, in words", examples=["2 shapes (1, 4)"])]
    accepted: Annotated[str, Field(description="what would be taken", examples=["exactly one shape of 1, 2, 3, 4"])]


class ProblemBody(_Body):
    """An error, as RFC 9457 has it; the body that was sent is never repeated."""

    type: Annotated[
        str, Field(description="identifies the kind of problem", examples=["urn:cazsl:problem:invalid_request"])
    ]
    title: Annotated[str, Field(description="the kind of problem in words", examples=["The request is not valid"])]
    status: Annotated[int, Field(description="the HTTP status", examples=[422])]
    code: Annotated[str, Field(description="stable, for programs", examples=["invalid_request"])]
    detail: Annotated[
        str, Field(description="what was received, what is accepted and where", examples=[_DETAIL_EXAMPLE])
    ]
    errors: Annotated[
        list[FaultBody], Field(description="each fault of the request, ten at most", examples=[[_FAULT_EXAMPLE]])
    ] = []
    request_id: Annotated[
        str,
        Field(
            description="as in the X-Request-ID header and in the log", examples=["3f0c7d2ab4e94c7f9f5d2b1a6c8e0d11"]
        ),
    ]
