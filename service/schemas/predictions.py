"""What the service answers: the bodies of answers and errors.

Every field carries its unit, an example and what it means; the OpenAPI document is made of these.
"""

import base64
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field

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
# what a model sees of the image that is the example in requests: a grey square in the middle, and its thumbnail
_SEEN_EXAMPLE = base64.b64encode(bytes(256) + (bytes(8) + b"\x80" * 16 + bytes(8)) * 16 + bytes(256)).decode()
_THUMBNAIL_EXAMPLE = (
    "iVBORw0KGgoAAAANSUhEUgAAAQAAAAEACAAAAAB5Gfe6AAABRklEQVR4nO3QgQkAIAwEMXVyR3cIhUNIBmiPHwMAAAAA"
    "AAAAAAAAAAAAAAD43bw9sB9ElP/Xi4ifGaAOqBmgDqgZoA6oGaAOqBmgDqgZoA6oGaAOqBmgDqgZoA6oGaAOqBmgDqgZ"
    "oA6oGaAOqBmgDqgZoA6oGaAOqBmgDqgZoA6oGaAOqBmgDqgZoA6oGaAOqBmgDqgZoA6oGaAOqBmgDqgZoA6oGaAOqBmg"
    "DqgZoA6oGaAOqBmgDqgZoA6oGaAOqBmgDqgZoA6oGaAOqBmgDqgZoA6oGaAOqBmgDqgZoA6oGaAOqBmgDqgZoA6oGaAO"
    "qBmgDqgZoA6oGaAOqBmgDqgZoA6oGaAOqBmgDqgZoA6oGaAOqBmgDqgZoA6oGaAOqBmgDqgZoA6oGaAOqBmgDqgZoA4A"
    "AAAAAAAAAAAAAAAAAAAAuHUAko8CAFqKhPgAAAAASUVORK5CYII="
)
_DETAIL_EXAMPLE = "{where}: received {received}; accepted is {accepted}".format(**_FAULT_EXAMPLE)


class Body(BaseModel):
    """What every body is: exact types, no unknown field, numbers finite."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False, frozen=True)


class ModelVersionBody(Body):
    """Which model answered."""

    name: Annotated[str, Field(description="name in the registry", examples=["push-indicator"])]
    version: Annotated[int, Field(ge=1, description="version, immutable", examples=[1])]


Frame = Annotated[
    Literal["object", "world"],
    Field(
        description="of every pose in the answer: the object's pose before the push, or the world, when the request "
        "said where the object is in it",
        examples=["object"],
    ),
]


class MeanBody(Body):
    """Expected pose of the object after the push, in the frame of the answer."""

    x: Annotated[float, Field(description="in m", examples=[0.021])]
    y: Annotated[float, Field(description="in m", examples=[0.001])]
    angle: Annotated[float, Field(description="in rad, in (-pi, pi]", examples=[0.03])]


class StdBody(Body):
    """Standard deviation of that pose; in the object frame the three are independent."""

    x: Annotated[float, Field(gt=0, description="in m", examples=[0.002])]
    y: Annotated[float, Field(gt=0, description="in m", examples=[0.001])]
    angle: Annotated[float, Field(gt=0, description="in rad", examples=[0.02])]


class PredictResponse(Body):
    """A Gaussian over the object's pose after the push."""

    model: ModelVersionBody
    frame: Frame
    mean: MeanBody
    std: StdBody
    covariance: Annotated[
        list[list[float]] | None,
        Field(
            description="3 x 3, of x, y, angle in m and rad; in the world frame only, where x and y may go together",
            examples=[[[4e-6, 0.0, 0.0], [0.0, 1e-6, 0.0], [0.0, 0.0, 4e-4]]],
        ),
    ] = None


class BatchResponse(Body):
    """A Gaussian over the object's pose after each push, in the order of the request."""

    model: ModelVersionBody
    frame: Frame
    mean: Annotated[
        list[list[float]],
        Field(
            description="x, y, angle in m, m, rad for each push, angle in (-pi, pi]", examples=[[[0.021, 0.001, 0.03]]]
        ),
    ]
    std: Annotated[
        list[list[float]],
        Field(description="standard deviations in m, m, rad for each push", examples=[[[0.002, 0.001, 0.02]]]),
    ]
    covariance: Annotated[
        list[list[list[float]]] | None,
        Field(
            description="3 x 3 for each push, of x, y, angle in m and rad; in the world frame only",
            examples=[[[[4e-6, 0.0, 0.0], [0.0, 1e-6, 0.0], [0.0, 0.0, 4e-4]]]],
        ),
    ] = None


class VisualContextBody(Body):
    """What a model sees of an image, to be used again, and what looks wrong in it."""

    visual: Annotated[
        str,
        Field(
            description="base64 of 1,024 grey levels, row by row: the field visual of a context",
            examples=[_SEEN_EXAMPLE],
        ),
    ]
    thumbnail_png: Annotated[
        str,
        Field(
            description="base64 of a PNG of 256 x 256 pixels: what the model sees, to be looked at",
            examples=[_THUMBNAIL_EXAMPLE],
        ),
    ]
    flags: Annotated[
        list[str],
        Field(
            description="what looks wrong: blank, clipped, off_centre, several_objects; then do not trust it far",
            examples=[[]],
        ),
    ]


class ModelBody(Body):
    """A model as it is served now."""

    name: Annotated[str, Field(description="name in the registry", examples=["push-indicator"])]
    method: Annotated[str, Field(description="row of the paper's tables", examples=["FCN + CM + L2Reg"])]
    context_kind: Annotated[str, Field(description="what it wants to know of the object", examples=["indicator"])]
    versions: Annotated[list[int], Field(description="versions served, oldest first", examples=[[1, 2]])]
    aliases: Annotated[dict[str, int], Field(description="what each alias means", examples=[{"champion": 2}])]


class ModelsBody(Body):
    """Every model that is served."""

    models: Annotated[list[ModelBody], Field(description="sorted by name", examples=[[_MODEL_EXAMPLE]])]


class ModelVersionDetailBody(Body):
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


class LiveBody(Body):
    """The process answers."""

    live: Annotated[Literal[True], Field(description="always true", examples=[True])] = True


class ModelCheckBody(Body):
    """One version that is loaded."""

    name: Annotated[str, Field(description="the model", examples=["push-indicator"])]
    version: Annotated[int, Field(description="its version", examples=[1])]
    ready: Annotated[bool, Field(description="its last tiny inference was right", examples=[True])]
    reason: Annotated[
        str | None,
        Field(description="why it cannot be asked", examples=["a tiny inference did not end within 10 s"]),
    ] = None


class ReadyBody(Body):
    """Whether predictions can be answered, and what is wrong with the registry where something is."""

    ready: Annotated[
        bool,
        Field(description="a model is loaded, passed all checks and answers; SIGTERM has not come", examples=[True]),
    ]
    reason: Annotated[
        str | None,
        Field(
            description="why not, and what is being done about it",
            examples=["not ready, looking again every 2 s, because the registry holds no model"],
        ),
    ] = None
    checks: Annotated[
        list[ModelCheckBody],
        Field(
            description="every version that is loaded",
            examples=[[{"name": "push-indicator", "version": 1, "ready": True, "reason": None}]],
        ),
    ]
    models: Annotated[dict[str, list[int]], Field(description="versions served", examples=[{"push-indicator": [1]}])]
    problems: Annotated[
        list[str],
        Field(
            description="why something published is not served; what was served before goes on being served",
            examples=[["push-indicator@2 is broken and not served: model.onnx: the sha256 differs"]],
        ),
    ]


class FaultBody(Body):
    """One fault in a request."""

    where: Annotated[str, Field(description="the field", examples=["body.context.indicator side 3"])]
    received: Annotated[str, Field(description="what came, in words", examples=["2 shapes (1, 4)"])]
    accepted: Annotated[str, Field(description="what would be taken", examples=["exactly one shape of 1, 2, 3, 4"])]


class ProblemBody(Body):
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
