"""Columns of a batch: from rows of three numbers in JSON to an array, without a closer look where none is needed.

What is plainly in order goes past pydantic, which takes twice as long over it. Whatever is not, pydantic judges, so
that what is accepted and the words of a refusal are those of the documented type.
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
_LIST, _LENGTH, _NUMBERS = {list}, {_POSE_PARTS}, {float, int}

_ALONG: Final[JsonDict] = {"type": "number", "minimum": -WORLD_M, "maximum": WORLD_M}
_Row = Annotated[
    list[float],
    FailFast(),
    Field(
        min_length=_POSE_PARTS,
        max_length=_POSE_PARTS,
        json_schema_extra={"prefixItems": [_ALONG, _ALONG, {"type": "number"}]},
    ),
]
DocumentedRows = Annotated[list[_Row], FailFast(), Field(min_length=1, max_length=MAX_PUSHES)]


def _schema(_: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
    return core_schema.no_info_wrap_validator_function(_to_array, handler.generate_schema(DocumentedRows))


Rows = Annotated[DoubleArray, GetPydanticSchema(_schema)]  # (n, 3), not to be written to: 1 to MAX_PUSHES rows


def _to_array(rows: Any, judge: ValidatorFunctionWrapHandler) -> DoubleArray:
    found = _plain(rows)
    return np.array(judge(rows), dtype=np.float64) if found is None else found


def _plain(rows: Any) -> DoubleArray | None:
    """Lists of three finite numbers each as an array; nothing for everything else."""
    if type(rows) is not list or not 1 <= len(rows) <= MAX_PUSHES:
        return None
    if set(map(type, rows)) != _LIST or set(map(len, rows)) != _LENGTH:
        return None
    flat = list(itertools.chain.from_iterable(rows))
    try:
        found = np.frombuffer(struct.pack(f"{len(flat)}d", *flat))
    except (struct.error, OverflowError):  # what is no number; an integer beyond float64
        return None
    if ((found == 0.0) | (found == 1.0)).any() and not set(map(type, flat)) <= _NUMBERS:  # truth values are packed too
        return None
    return found.reshape(-1, _POSE_PARTS) if np.isfinite(found).all() else None
