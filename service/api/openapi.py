"""Examples of the OpenAPI document: errors as the service writes them, and answers made from the examples of fields.

A route names the errors that it can raise. This module has one error of each class and renders it. If an answer or a
parameter of an operation has no example, one is built from the examples of its fields, so that none is kept twice.
"""

import json
from collections.abc import Iterator
from typing import Any, Final

from service.errors import (
    BodyTooLargeError,
    CazslError,
    ContextKindError,
    DeadlineError,
    ForbiddenError,
    ImageTooLargeError,
    InvalidImageError,
    InvalidRequestError,
    MalformedBodyError,
    MissingKeyError,
    ModelNotReadyError,
    NotAcceptableError,
    OverloadedError,
    PredictionError,
    SlowBodyError,
    TooManyRequestsError,
    UnknownModelError,
    UnsupportedImageError,
    UnsupportedMediaTypeError,
)
from service.observability.records import RequestRecord, attach_record
from service.transport.problems import MEDIA_TYPE, internal_error, render_error

_REQUEST_ID: Final = "3f0c7d2ab4e94c7f9f5d2b1a6c8e0d11"
ERRORS: Final = (
    internal_error(),
    MalformedBodyError(
        "body: received no JSON (EOF while parsing a value at line 1 column 0); accepted is JSON in UTF-8"
    ),
    MissingKeyError(),
    ForbiddenError("predict"),
    UnknownModelError("model: received a reference that is not served; accepted is one of: push-indicator@1"),
    NotAcceptableError(),
    SlowBodyError(10.0),
    BodyTooLargeError(12 << 20),
    ImageTooLargeError("image", "30000 x 20000 pixels", "up to 12582912 pixels and 8192 on a side"),
    UnsupportedMediaTypeError(
        "header Content-Encoding: received a compressed body; accepted is a plain body without this header"
    ),
    UnsupportedImageError("image: received 35 bytes of another format; accepted is PNG, JPEG or WebP"),
    InvalidRequestError.at("body.context.indicator side 3", "2 shapes (1, 4)", "exactly one shape of 1, 2, 3, 4"),
    ContextKindError.at("body.context", "kind visual", "a context of kind indicator for push-indicator"),
    InvalidImageError.at("image", "a file that stops before the picture does", "a whole PNG, JPEG or WebP"),
    TooManyRequestsError(8),
    PredictionError("the runtime could not evaluate the model"),
    ModelNotReadyError("no model is loaded: none is published"),
    OverloadedError("256 requests in flight"),
    DeadlineError(10.0),
)
_PROTOCOL_ERRORS: Final = (  # errors that have other messages there
    InvalidRequestError.at("inputs pusher.shape", "another shape", "[n (1 to 10000), 3]"),
    UnsupportedMediaTypeError("header Content-Encoding: received another encoding; accepted is gzip or deflate"),
)
_KNOWN: Final = {
    "/v1": {type(error): error for error in ERRORS},
    "/v2": {type(error): error for error in (*ERRORS, *_PROTOCOL_ERRORS)},
}
Kind = type[CazslError] | CazslError


def problems(schema: type[Any], *kinds: Kind) -> dict[int | str, dict[str, Any]]:
    """Return the documented errors of a route under ``/v1``, by their classes, or by an error with its own message."""
    return _responses("/v1", "a problem, see its code", schema, MEDIA_TYPE, kinds)


def protocol_errors(schema: type[Any], *kinds: Kind) -> dict[int | str, dict[str, Any]]:
    """Return the documented errors of a route under ``/v2``. See ``problems``."""
    return _responses("/v2", "an error in the form of the protocol", schema, "application/json", kinds)


def _responses(
    prefix: str, description: str, schema: type[Any], media_type: str, kinds: tuple[Kind, ...]
) -> dict[int | str, dict[str, Any]]:
    found: dict[int | str, dict[str, Any]] = {}
    for kind in kinds:
        error = _KNOWN[prefix][kind] if isinstance(kind, type) else kind
        status, value = _written(prefix, error)
        content = {media_type: {"examples": dict[str, Any]()}}
        response = found.setdefault(status, {"description": description, "model": schema, "content": content})
        known = {"$ref": f"#/components/examples/{_name(prefix, error)}"}
        own = {"summary": error.title, "value": value}
        response["content"][media_type]["examples"][error.code] = known if isinstance(kind, type) else own
    return found


def give_examples(document: dict[str, Any]) -> dict[str, Any]:
    """Add the errors that routes refer to, and the missing examples, to an OpenAPI document."""
    used = json.dumps(document["paths"])
    document["components"]["examples"] = {
        _name(prefix, error): {"summary": error.title, "value": _written(prefix, error)[1]}
        for prefix, errors in _KNOWN.items()
        for error in errors.values()
        if f'/{_name(prefix, error)}"' in used
    }
    for operation in _operations(document):
        for parameter in operation.get("parameters", ()):
            parameter["example"] = parameter["schema"]["examples"][0]
        for response in operation["responses"].values():
            for media in response.get("content", {}).values():
                if not {"example", "examples"} & media.keys():
                    media["examples"] = _answers(document, media["schema"])
    return document


def _operations(document: dict[str, Any]) -> Iterator[dict[str, Any]]:
    for operations in document["paths"].values():
        yield from operations.values()


def _answers(document: dict[str, Any], schema: dict[str, Any]) -> dict[str, Any]:
    """Return an example of each form of an answer."""
    forms = schema.get("anyOf", [schema])
    names = [form["$ref"].rpartition("/")[2] for form in forms]
    return {name: {"value": _example(document, form)} for name, form in zip(names, forms, strict=True)}


def _example(document: dict[str, Any], schema: dict[str, Any]) -> Any:
    """Return the example of a schema, or else the examples of its fields that are always present."""
    if "$ref" in schema and "examples" not in schema:
        schema = document["components"]["schemas"][schema["$ref"].rpartition("/")[2]]
    if "examples" in schema:
        return schema["examples"][0]
    fields = schema["properties"]
    return {name: _example(document, field) for name, field in fields.items() if _is_always_there(field)}


def _is_always_there(field: dict[str, Any]) -> bool:
    return {"type": "null"} not in field.get("anyOf", ())


def _written(prefix: str, error: CazslError) -> tuple[int, Any]:
    scope: dict[str, Any] = {"path": prefix}
    attach_record(scope, RequestRecord(_REQUEST_ID, "POST"))
    response = render_error(scope, error)
    return response.status_code, json.loads(bytes(response.body))


def _name(prefix: str, error: CazslError) -> str:
    return f"{prefix[1:]}_{error.code}"


def state_media_type(document: dict[str, Any]) -> dict[str, Any]:
    """Set the media type of problems in an OpenAPI document. FastAPI declares every model as application/json."""
    for operations in document["paths"].values():
        for operation in operations.values():
            for response in operation["responses"].values():
                content = response.get("content", {})
                if content.get("application/json", {}).get("schema") == {"$ref": "#/components/schemas/ProblemBody"}:
                    response["content"] = {MEDIA_TYPE: content.get(MEDIA_TYPE, {}) | content["application/json"]}
    return document
