"""Bodies of the health routes: liveness and readiness."""

from typing import Annotated, Literal

from pydantic import Field

from service.schemas.body import Body


class LiveBody(Body):
    """Process is alive: it answers."""

    live: Annotated[Literal[True], Field(description="always true", examples=[True])] = True


class ModelCheckBody(Body):
    """Check of one loaded version."""

    name: Annotated[str, Field(description="name of the model", examples=["push-indicator"])]
    version: Annotated[int, Field(description="number of the version", examples=[1])]
    ready: Annotated[bool, Field(description="the last test prediction of this version was correct", examples=[True])]
    reason: Annotated[
        str | None,
        Field(description="why this version is not ready", examples=["a tiny inference did not end within 10 s"]),
    ] = None


class TaskBody(Body):
    """Background task of the service, such as the polling of the registry. It is started again after each failure."""

    name: Annotated[str, Field(description="name of the task", examples=["poll"])]
    age_s: Annotated[
        float,
        Field(description="time since the last success, or 0 while the task has no work, in s", examples=[1.25]),
    ]
    late: Annotated[
        bool, Field(description="true if the task hangs or fails each time, for a long time", examples=[False])
    ]
    failures: Annotated[int, Field(description="number of failures since the start", examples=[0])]
    error: Annotated[
        str | None,
        Field(
            description="type of the last failure, unless a success followed. The log has its cause.", examples=[None]
        ),
    ] = None


class ReadyBody(Body):
    """Readiness: whether the service can answer predictions, and the problems of the registry."""

    ready: Annotated[
        bool,
        Field(
            description="true if the default models answer and no SIGTERM was received",
            examples=[True],
        ),
    ]
    reason: Annotated[
        str | None,
        Field(
            description="why the service is not ready, and how it tries to become ready",
            examples=["not ready, looking again every 2 s, because the registry holds no model"],
        ),
    ] = None
    checks: Annotated[
        list[ModelCheckBody],
        Field(
            description="the check of every loaded version",
            examples=[[{"name": "push-indicator", "version": 1, "ready": True, "reason": None}]],
        ),
    ]
    models: Annotated[
        dict[str, list[int]],
        Field(description="versions that are served, by model", examples=[{"push-indicator": [1]}]),
    ]
    problems: Annotated[
        list[str],
        Field(
            description="faults of the registry, each with its model and cause (versions that are not served, entries "
            "that cannot be read, content that vanished without a removal), and problems of the file of API keys. "
            "Versions served before stay served, and keys accepted before stay accepted.",
            examples=[["push-indicator@2 is broken and not served: model.onnx: the sha256 differs"]],
        ),
    ]
    tasks: Annotated[
        list[TaskBody],
        Field(
            description="the background tasks of the service. They do not change readiness.",
            examples=[[{"name": "poll", "age_s": 1.25, "late": False, "failures": 0, "error": None}]],
        ),
    ]
