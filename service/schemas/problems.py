"""Bodies of errors (RFC 9457)."""

from typing import Annotated

from pydantic import Field

from service.schemas.body import Body

_FAULT_EXAMPLE = {
    "where": "body.context.indicator side 3",
    "received": "2 shapes (1, 4)",
    "accepted": "exactly one shape of 1, 2, 3, 4",
}
_DETAIL_EXAMPLE = "{where}: received {received}; accepted is {accepted}".format(**_FAULT_EXAMPLE)


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
    ] = []  # noqa: RUF012 (pydantic copies it)
    request_id: Annotated[
        str,
        Field(
            description="as in the X-Request-ID header and in the log", examples=["3f0c7d2ab4e94c7f9f5d2b1a6c8e0d11"]
        ),
    ]
