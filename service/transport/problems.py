"""Every failure as ``application/problem+json`` (RFC 9457), under ``/v2`` as that protocol's ``{"error": text}``.

Never a traceback, a path or the body.
"""

import re
from collections.abc import Mapping, Sequence
from http import HTTPStatus
from typing import Any, Final

import orjson
from fastapi.responses import Response
from starlette.types import Scope

from service.errors import CazslError, FieldFault, InvalidRequestError
from service.observability.telemetry import request_id_of
from service.schemas.problems import FaultBody, ProblemBody

MEDIA_TYPE: Final = "application/problem+json"
MAX_FAULTS: Final = 10
_SAFE_NAME = re.compile(r"[A-Za-z0-9_]{1,32}")
_HEADERS: Final[Mapping[HTTPStatus, Mapping[str, str]]] = {
    HTTPStatus.UNAUTHORIZED: {"WWW-Authenticate": "Bearer"},
    HTTPStatus.REQUEST_TIMEOUT: {"Connection": "close"},  # the rest of the body is not waited for
    HTTPStatus.TOO_MANY_REQUESTS: {"Retry-After": "1"},
    HTTPStatus.SERVICE_UNAVAILABLE: {"Retry-After": "1"},
}


def problem_response(scope: Scope, error: CazslError) -> Response:
    """The answer for an error of our tree; what went wrong inside is told to the log, not to the client."""
    faults = error.faults[:MAX_FAULTS] if isinstance(error, InvalidRequestError) else ()
    return _render(scope, error.status, error.code, error.title, str(error), faults, _HEADERS.get(error.status))


def _render(
    scope: Scope,
    status: int,
    code: str,
    title: str,
    detail: str,
    faults: Sequence[FieldFault],
    headers: Mapping[str, str] | None,
) -> Response:
    scope.setdefault("state", {})["refusal"] = code
    if scope["path"].startswith("/v2"):
        if status == HTTPStatus.UNPROCESSABLE_ENTITY:
            status = HTTPStatus.BAD_REQUEST  # the protocol knows no other for a request that is not in order
        return Response(orjson.dumps({"error": detail}), int(status), headers, media_type="application/json")
    content = problem_body(HTTPStatus(status), code, title, detail, faults, request_id_of(scope))
    return Response(content, int(status), headers, media_type=MEDIA_TYPE)


def problem_body(
    status: HTTPStatus, code: str, title: str, detail: str, faults: Sequence[FieldFault] = (), request_id: str = ""
) -> bytes:
    """The document of a problem."""
    body = ProblemBody(
        type=f"urn:cazsl:problem:{code}",
        title=title,
        status=int(status),
        code=code,
        detail=detail,
        errors=[FaultBody(where=fault.where, received=fault.received, accepted=fault.accepted) for fault in faults],
        request_id=request_id,
    )
    return body.model_dump_json().encode()


def invalid_request(found: Sequence[Mapping[str, Any]]) -> InvalidRequestError:
    """What pydantic found, as our error: ten faults at most, and never what was sent."""
    return InvalidRequestError([_fault(fault) for fault in found[:MAX_FAULTS]])


def _fault(found: Mapping[str, Any]) -> FieldFault:
    """A pydantic error without the value that it carries."""
    path = [str(part) for part in found["loc"]]
    kind, message = found["type"], str(found["msg"])
    if kind == "extra_forbidden":
        name = path.pop()
        received = f"the field {name}" if _SAFE_NAME.fullmatch(name) else "a field with an unusual name"
        return FieldFault(".".join(path), received, "the fields of the schema only, see /docs")
    accepted = message.removeprefix("Input should be ")
    if kind == "missing":
        return FieldFault(".".join(path), "nothing", "a value, it is required")
    context = found.get("ctx") or {}
    if kind in ("too_short", "too_long") and "actual_length" in context:
        wanted = context.get("min_length", context.get("max_length"))
        return FieldFault(".".join(path), f"{context['actual_length']} values", f"{wanted} values")
    return FieldFault(".".join(path), _in_words(found.get("input")), accepted)


def _in_words(value: Any) -> str:
    """What kind of thing came: a number as it is, anything else by its kind and length."""
    match value:
        case None:
            return "null"
        case bool():
            return "true or false"
        case int() | float() if abs(value) < 1e15:
            return f"{value!r}"
        case int() | float():
            return "a number that is not finite or too large"
        case str():
            return f"a text of {len(value)} characters"
        case list():
            return f"a list of {len(value)} values"
        case _:
            return "an object"
