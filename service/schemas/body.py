"""Base of every body, and the reading of bodies. No other module turns errors of pydantic into errors of the tree."""

import itertools
import re
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any, Final, TypeVar

from pydantic import BaseModel, BeforeValidator, ConfigDict, GetCoreSchemaHandler, ValidationError
from pydantic_core import CoreSchema, PydanticKnownError, core_schema

from service.errors import FieldFault, InvalidRequestError
from service.schemas.documents import parse_json

MAX_FAULTS: Final = 10
PLAIN_BYTES: Final = 16 * 1024
"""Size up to which a body is read in one pass. A body that fails there is read again, to be refused in words."""
_SAFE_NAME = re.compile(r"[A-Za-z0-9_]{1,32}")
_SAFE_PART = re.compile(r"[A-Za-z0-9_\[\]]{1,32}")  # with brackets: the name of a type in a union
_BODY: Final = ("body",)
_ACCEPTED: Final = {  # pydantic would name types of Python
    "model_type": "an object",
    "list_type": "a list",
    "none_required": "null, or no such field: it is not supported",
}


def _few_fields(known: frozenset[str], found: Any) -> Any:
    """Return an object without most of its unknown fields, if there are more of them than an answer names."""
    if type(found) is not dict or len(found) <= len(known) + MAX_FAULTS:
        return found
    unknown = itertools.islice((name for name in found if name not in known), MAX_FAULTS)
    return {name: found[name] for name in (*(known & found.keys()), *unknown)}


class Body(BaseModel):
    """A body with exact types, no unknown field, and finite numbers.

    A document has at most ``MAX_FAULTS`` faults of unknown fields per object, however many fields it has. A list field
    is ``FailFast`` or ``at_most`` a few values long, so that it has few faults too.
    """

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False, frozen=True)

    @classmethod
    def __get_pydantic_core_schema__(cls, source: type[BaseModel], handler: GetCoreSchemaHandler) -> CoreSchema:
        """Return the schema of the fields, which sees a few unknown fields of each object at most."""
        schema: dict[str, Any] = {**handler(source)}
        reference = schema.pop("ref", None)
        few = core_schema.no_info_before_validator_function(partial(_few_fields, frozenset(cls.model_fields)), schema)
        return core_schema.json_or_python_schema(json_schema=schema, python_schema=few, ref=reference)


def at_most(length: int) -> BeforeValidator:
    """Return a validator that refuses a longer list before its values are validated: each might be a fault."""

    def check(found: Any) -> Any:
        """Return the value, unless it is a longer list."""
        if isinstance(found, list) and len(found) > length:
            lengths = {"field_type": "List", "max_length": length, "actual_length": len(found)}
            raise PydanticKnownError("too_long", lengths)
        return found

    return BeforeValidator(check)


B = TypeVar("B", bound=Body)


def parse_body(kind: type[B], content: bytes, prefix: tuple[str, ...] = _BODY) -> B:
    """Read a body from its JSON, in bounded time and memory.

    Raises:
        MalformedBodyError: the content is not JSON in UTF-8.
        InvalidRequestError: a field is missing, unknown or not allowed, or see ``parse_json``. The message names at
            most ``MAX_FAULTS``.
    """
    if len(content) <= PLAIN_BYTES:
        try:
            found: B = kind.__pydantic_validator__.validate_json(content)
        except ValidationError:
            pass  # its faults may be thousands
        else:
            return found
    return validate_body(kind, parse_json(content), prefix)


def validate_body(kind: type[B], document: object, prefix: tuple[str, ...] = _BODY) -> B:
    """Validate a document that ``parse_json`` returned.

    Raises:
        InvalidRequestError: see ``parse_body``.
    """
    try:
        return kind.model_validate(document)
    except ValidationError as error:
        refusal = invalid_request(error.errors(include_url=False), prefix)
    raise refusal  # without a cause: that would hold the document


def invalid_request(found: Sequence[Mapping[str, Any]], prefix: tuple[str, ...] = ()) -> InvalidRequestError:
    """Return errors of pydantic as one error of the tree: at most ``MAX_FAULTS``, and never a text that was sent."""
    return InvalidRequestError([_fault(fault, prefix) for fault in found[:MAX_FAULTS]])


def _fault(found: Mapping[str, Any], prefix: tuple[str, ...]) -> FieldFault:
    """Return an error of pydantic without the value that it carries."""
    path = [*prefix, *map(_part, found["loc"])] or ["body"]
    kind, message = found["type"], str(found["msg"])
    if kind == "extra_forbidden":
        name = str(found["loc"][-1])
        received = f"the field {name}" if _SAFE_NAME.fullmatch(name) else "a field with an unusual name"
        return FieldFault(".".join(path[:-1]) or "body", received, "the fields of the schema only, see /docs")
    if kind == "missing":
        return FieldFault(".".join(path), "no value", "a value: the field is required")
    context = found.get("ctx") or {}
    if kind in ("too_short", "too_long") and "actual_length" in context:
        wanted = f"at least {context['min_length']}" if kind == "too_short" else f"at most {context['max_length']}"
        return FieldFault(".".join(path), f"{context['actual_length']} values", wanted)
    accepted = _ACCEPTED.get(kind, message.removeprefix("Input should be ").removeprefix("String should have "))
    return FieldFault(".".join(path), _describe(found.get("input")), accepted)


def _part(part: int | str) -> str:
    """Return a part of a path. Names that a client chose may be long, or hold anything."""
    text = str(part)
    return text if _SAFE_PART.fullmatch(text) else "(a field with an unusual name)"


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
