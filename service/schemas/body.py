"""Base of every body, and the reading of bodies. No other module turns errors of pydantic into errors of the tree."""

import re
from collections.abc import Mapping, Sequence
from typing import Any, Final, TypeVar

import pydantic_core
from pydantic import BaseModel, ConfigDict, ValidationError

from service.errors import FieldFault, InvalidRequestError, MalformedBodyError

MAX_FAULTS: Final = 10
_SAFE_NAME = re.compile(r"[A-Za-z0-9_]{1,32}")
_BODY: Final = ("body",)
_ACCEPTED: Final = {"model_type": "an object", "list_type": "a list"}  # pydantic would name types of Python


class Body(BaseModel):
    """A body with exact types, no unknown field, and finite numbers."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False, frozen=True)


B = TypeVar("B", bound=BaseModel)


def parse_body(kind: type[B], content: bytes, prefix: tuple[str, ...] = _BODY) -> B:
    """Read a body from its JSON in one pass.

    Raises:
        MalformedBodyError: the content is not JSON in UTF-8.
        InvalidRequestError: a field is missing, unknown or not allowed. The message names at most ``MAX_FAULTS``.
    """
    try:
        found: B = kind.__pydantic_validator__.validate_json(content)
    except ValidationError as error:
        raise _refusal(error, prefix) from error
    return found


def parse_json(content: bytes) -> Any:
    """Parse a JSON document in UTF-8, for ``validate_body``. NaN is accepted here, and refused by the fields.

    Raises:
        MalformedBodyError: the content is not JSON in UTF-8.
    """
    try:
        return pydantic_core.from_json(content)
    except ValueError as error:
        raise _malformed(str(error)) from error


def validate_body(kind: type[B], document: object, prefix: tuple[str, ...] = _BODY) -> B:
    """Validate a document that ``parse_json`` returned.

    Raises:
        InvalidRequestError: see ``parse_body``.
    """
    try:
        return kind.model_validate(document)
    except ValidationError as error:
        raise _refusal(error, prefix) from error


def invalid_request(found: Sequence[Mapping[str, Any]], prefix: tuple[str, ...] = ()) -> InvalidRequestError:
    """Return errors of pydantic as one error of the tree: at most ``MAX_FAULTS``, and never a text that was sent."""
    return InvalidRequestError([_fault(fault, prefix) for fault in found[:MAX_FAULTS]])


def _refusal(error: ValidationError, prefix: tuple[str, ...]) -> InvalidRequestError | MalformedBodyError:
    found = error.errors(include_url=False)
    if found[0]["type"] == "json_invalid":
        return _malformed(found[0]["msg"].removeprefix("Invalid JSON: "))
    return invalid_request(found, prefix)


def _malformed(reason: str) -> MalformedBodyError:
    return MalformedBodyError(f"body: received no JSON ({reason}); accepted is JSON in UTF-8")


def _fault(found: Mapping[str, Any], prefix: tuple[str, ...]) -> FieldFault:
    """Return an error of pydantic without the value that it carries."""
    path = [*prefix, *map(str, found["loc"])] or ["body"]
    kind, message = found["type"], str(found["msg"])
    if kind == "extra_forbidden":
        name = path.pop()
        received = f"the field {name}" if _SAFE_NAME.fullmatch(name) else "a field with an unusual name"
        return FieldFault(".".join(path), received, "the fields of the schema only, see /docs")
    if kind == "missing":
        return FieldFault(".".join(path), "no value", "a value: the field is required")
    context = found.get("ctx") or {}
    if kind in ("too_short", "too_long") and "actual_length" in context:
        wanted = f"at least {context['min_length']}" if kind == "too_short" else f"at most {context['max_length']}"
        return FieldFault(".".join(path), f"{context['actual_length']} values", wanted)
    accepted = _ACCEPTED.get(kind, message.removeprefix("Input should be "))
    return FieldFault(".".join(path), _describe(found.get("input")), accepted)


def _describe(value: Any) -> str:
    """Describe a value by its type and length, and a number by itself."""
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
