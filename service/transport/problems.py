"""Answers to failures: ``application/problem+json`` (RFC 9457), and under ``/v2`` that protocol's ``{"error": text}``.

They never hold a traceback, a path of the server, or the body that was sent. They have a few KiB at most.
"""

import logging
from collections.abc import Mapping, Sequence
from http import HTTPStatus
from typing import Final

import orjson
from starlette.responses import Response
from starlette.types import Scope

from service.errors import CazslError, FieldFault, InvalidRequestError
from service.observability.records import record_of
from service.schemas.body import MAX_FAULTS
from service.schemas.problems import FaultBody, ProblemBody

logger = logging.getLogger(__name__)
MEDIA_TYPE: Final = "application/problem+json"
MAX_DETAIL: Final = 1_200
MAX_PART: Final = 160  # characters of a part of a fault
_HEADERS: Final[Mapping[HTTPStatus, Mapping[str, str]]] = {
    HTTPStatus.UNAUTHORIZED: {"WWW-Authenticate": "Bearer"},
    HTTPStatus.REQUEST_TIMEOUT: {"Connection": "close"},  # the service does not await the rest of the body
    HTTPStatus.TOO_MANY_REQUESTS: {"Retry-After": "1"},
    HTTPStatus.SERVICE_UNAVAILABLE: {"Retry-After": "1"},
}


def problem_response(scope: Scope, error: BaseException) -> Response:
    """Return the answer for an error. Its causes are not sent to the client.

    The cause of every 500 is logged under the id of its request. Every 500 of the service is made here.
    """
    if not isinstance(error, CazslError):
        _log_cause(scope, error)
        error = internal_error()
    elif error.status == HTTPStatus.INTERNAL_SERVER_ERROR:
        _log_cause(scope, error)
    else:
        _forget_frames(error)
    return render_error(scope, error)


def render_error(scope: Scope, error: CazslError) -> Response:
    """Return the answer for an error of our tree, without a line of the log."""
    faults = error.faults[:MAX_FAULTS] if isinstance(error, InvalidRequestError) else ()
    return render_problem(scope, error.status, error.code, error.title, str(error), faults, _HEADERS.get(error.status))


def _log_cause(scope: Scope, error: BaseException) -> None:
    logger.error("request failed", extra={"request_id": record_of(scope).request_id}, exc_info=error)


def internal_error() -> CazslError:
    """Return the error for an exception that is not of our tree."""
    return CazslError("the request could not be answered; the log has the cause under this request_id")


def render_problem(
    scope: Scope,
    status: int,
    code: str,
    title: str,
    detail: str,
    faults: Sequence[FieldFault] = (),
    headers: Mapping[str, str] | None = None,
) -> Response:
    """Return the answer for a failure, and note the code in the record of the request."""
    record = record_of(scope)
    record.code = code
    if scope["path"].startswith("/v2"):
        if status == HTTPStatus.UNPROCESSABLE_ENTITY:
            status = HTTPStatus.BAD_REQUEST  # the protocol has no other status for invalid requests
        return Response(
            orjson.dumps({"error": _shortened(detail, MAX_DETAIL)}), int(status), headers, media_type="application/json"
        )
    content = problem_body(HTTPStatus(status), code, title, detail, faults, record.request_id)
    return Response(content, int(status), headers, media_type=MEDIA_TYPE)


def problem_body(
    status: HTTPStatus, code: str, title: str, detail: str, faults: Sequence[FieldFault] = (), request_id: str = ""
) -> bytes:
    """Return the document of a problem. Long texts are cut, because some name what is served."""
    body = ProblemBody(
        type=f"urn:cazsl:problem:{code}",
        title=title,
        status=int(status),
        code=code,
        detail=_shortened(detail, MAX_DETAIL),
        errors=[_fault_body(fault) for fault in faults[:MAX_FAULTS]],
        request_id=request_id,
    )
    return body.model_dump_json().encode()


def _forget_frames(error: BaseException | None) -> None:
    """Forget where a refusal was raised. Its frames hold the request, and they and a future hold each other."""
    while error is not None:
        error.__traceback__ = None
        error = error.__cause__ or error.__context__


def _fault_body(fault: FieldFault) -> FaultBody:
    parts = {part: _shortened(getattr(fault, part), MAX_PART) for part in ("where", "received", "accepted")}
    return FaultBody(**parts)


def _shortened(text: str, length: int) -> str:
    return text if len(text) <= length else f"{text[: length - 1]}…"
