"""Rows of a batch: from lists of three numbers in JSON to an array (n, 3).

Rows that are plain lists of finite numbers are converted here, in half the time that pydantic takes. All others are
validated by pydantic, so the documented type decides which values are accepted and how a refusal is worded.
"""

import itertools
import struct
from typing import Annotated, Any, Final

import numpy as np
from pydantic import FailFast, Field, GetCoreSchemaHandler, GetPydanticSchema, ValidatorFunctionWrapHandler
from pydantic.config import JsonDict
from pydantic_core import CoreSchema, core_schema

from service.pushing.poses import WORLD_M, DoubleArray

MAX_PUSHES: Final = 10_000
_POSE_PARTS: Final = 3
_ROW_TYPES, _ROW_LENGTHS, _NUMBER_TYPES = {list}, {_POSE_PARTS}, {float, int}
_COORDINATE: Final[JsonDict] = {"type": "number", "minimum": -WORLD_M, "maximum": WORLD_M}
_Row = Annotated[
    list[float],
    FailFast(),
    Field(
        min_length=_POSE_PARTS,
        max_length=_POSE_PARTS,
        json_schema_extra={"prefixItems": [_COORDINATE, _COORDINATE, {"type": "number"}]},
    ),
]
DocumentedRows = Annotated[list[_Row], FailFast(), Field(min_length=1, max_length=MAX_PUSHES)]


def _schema(_: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
    return core_schema.no_info_wrap_validator_function(_to_array, handler.generate_schema(DocumentedRows))


Rows = Annotated[DoubleArray, GetPydanticSchema(_schema)]  # (n, 3), read-only, with 1 to MAX_PUSHES rows


def _to_array(rows: Any, validate: ValidatorFunctionWrapHandler) -> DoubleArray:
    found = _convert(rows)
    return np.array(validate(rows), dtype=np.float64) if found is None else found


def _convert(rows: Any) -> DoubleArray | None:
    """Convert a list of lists of three finite numbers to an array (n, 3). Return None for any other value."""
    if type(rows) is not list or not 1 <= len(rows) <= MAX_PUSHES:
        return None
    if set(map(type, rows)) != _ROW_TYPES or set(map(len, rows)) != _ROW_LENGTHS:
        return None
    flat = list(itertools.chain.from_iterable(rows))
    try:
        found = np.frombuffer(struct.pack(f"{len(flat)}d", *flat))
    except (struct.error, OverflowError):  # a value that is no number, or an integer beyond float64
        return None
    if ((found == 0.0) | (found == 1.0)).any() and not set(map(type, flat)) <= _NUMBER_TYPES:  # booleans are packed too
        return None
    return found.reshape(-1, _POSE_PARTS) if np.isfinite(found).all() else None
