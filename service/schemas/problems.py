"""Bodies of errors: problem details (RFC 9457)."""

from typing import Annotated

from pydantic import FailFast, Field

from service.schemas.body import Body

_FAULT_EXAMPLE = {
    "where": "body.context.indicator side 3",
    "received": "2 shapes (1, 4)",
    "accepted": "exactly one shape of 1, 2, 3, 4",
}
_DETAIL_EXAMPLE = "{where}: received {received}; accepted is {accepted}".format(**_FAULT_EXAMPLE)


class FaultBody(Body):
    """Fault of a request: the field, the received value and the accepted values."""

    where: Annotated[str, Field(description="the faulty field", examples=["body.context.indicator side 3"])]
    received: Annotated[str, Field(description="description of the received value", examples=["2 shapes (1, 4)"])]
    accepted: Annotated[
        str, Field(description="description of the accepted values", examples=["exactly one shape of 1, 2, 3, 4"])
    ]


class ProblemBody(Body):
    """Error as RFC 9457 problem details. It never repeats the body that was sent."""

    type: Annotated[
        str, Field(description="URN of the kind of problem", examples=["urn:cazsl:problem:invalid_request"])
    ]
    title: Annotated[str, Field(description="title of the kind of problem", examples=["The request is not valid"])]
    status: Annotated[int, Field(description="the HTTP status", examples=[422])]
    code: Annotated[
        str, Field(description="code of the kind of problem, which programs can rely on", examples=["invalid_request"])
    ]
    detail: Annotated[
        str, Field(description="the faulty field, the received and the accepted value", examples=[_DETAIL_EXAMPLE])
    ]
    errors: Annotated[
        list[FaultBody],
        FailFast(),
        Field(description="faults of the request, at most ten", examples=[[_FAULT_EXAMPLE]]),
    ] = []  # noqa: RUF012 (pydantic copies it)
    request_id: Annotated[
        str,
        Field(
            description="identifier of the request, also in the X-Request-ID header and in the log",
            examples=["3f0c7d2ab4e94c7f9f5d2b1a6c8e0d11"],
        ),
    ]
