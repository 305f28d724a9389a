"""Bodies of the health routes."""

from typing import Annotated, Literal

from pydantic import Field

from service.schemas.body import Body


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
