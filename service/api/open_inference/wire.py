"""Tensors as the Open Inference Protocol carries them: JSON, or JSON followed by raw bytes.

The binary extension puts the tensors that have a ``binary_data_size`` behind the JSON, in the order of the JSON's list:
little-endian, row-major, no padding. Every size is checked against what it must be before anything is allocated.
Sources: Open Inference Protocol V2 (REST), and the binary tensor data extension.
"""

import itertools
import math
from collections.abc import Sequence
from typing import Annotated, Any, Final

import numpy as np
import numpy.typing as npt
import orjson
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from service.errors import (
    FieldFault,
    InvalidRequestError,
    MalformedBodyError,
)
from service.model.tensors import Tensor

DATATYPES: Final = {"float32": "FP32", "int64": "INT64"}
_DTYPES: Final[dict[str, np.dtype[Any]]] = {"FP32": np.dtype("<f4"), "INT64": np.dtype("<i8")}
_JSON_KINDS: Final[dict[str, set[type]]] = {"FP32": {int, float}, "INT64": {int}}
LARGEST_RANK: Final = 4
MAX_ROWS: Final = 10_000
Array = npt.NDArray[Any]
Parameters = dict[str, bool | int | float | str | None]


class _Part(BaseModel):
    """The protocol is open: what we do not know is left alone."""

    model_config = ConfigDict(extra="ignore", strict=True, frozen=True)


class InputPart(_Part):
    """One input tensor as the JSON has it."""

    name: str
    shape: Annotated[list[int], Field(min_length=1, max_length=LARGEST_RANK)]
    datatype: str
    parameters: Parameters | None = None
    data: list[Any] | None = None


class OutputPart(_Part):
    """One output that is asked for."""

    name: str
    parameters: Parameters | None = None


class InferPart(_Part):
    """The JSON of an inference request."""

    id: Annotated[str | None, Field(max_length=256)] = None
    parameters: Parameters | None = None
    inputs: Annotated[list[InputPart], Field(min_length=1, max_length=8)]
    outputs: Annotated[list[OutputPart] | None, Field(max_length=8)] = None


def read_json(content: bytes, header_length: str | None) -> tuple[InferPart, memoryview]:
    """The JSON of a request, and what follows it.

    Raises:
        MalformedBodyError: the length in the header does not fit, or it is no JSON.
        InvalidRequestError: it is JSON of another form.
    """
    length = len(content)
    if header_length is not None:
        if not header_length.isascii() or not header_length.isdigit() or not 0 < int(header_length[:12]) <= length:
            accepted = f"the length of the JSON, 1 to {length} bytes"
            raise MalformedBodyError(
                f"header Inference-Header-Content-Length: received another number; accepted is {accepted}"
            )
        length = int(header_length[:12])
    try:
        part = InferPart.model_validate_json(content[:length])
    except ValidationError as error:
        found = error.errors(include_url=False, include_input=False, include_context=False)[:10]
        if found[0]["type"] == "json_invalid":
            raise MalformedBodyError(
                f"body: received no JSON ({found[0]['msg']}); accepted is JSON in UTF-8"
            ) from error
        faults = [FieldFault(".".join(map(str, fault["loc"])), "something else", fault["msg"]) for fault in found]
        raise InvalidRequestError(faults) from error
    return part, memoryview(content)[length:]


def read_inputs(part: InferPart, raw: memoryview, expected: Sequence[Tensor]) -> dict[str, Array]:
    """The input tensors by name, of the expected types and ranks, finite; which of them must be there is not judged.

    Raises:
        InvalidRequestError: a tensor is unknown, twice there, of another type or shape, or not of the size it says.
    """
    wanted = {tensor.name: tensor for tensor in expected}
    found: dict[str, Array] = {}
    for given in part.inputs:
        tensor = wanted.get(given.name)
        if tensor is None or given.name in found:
            raise _fault("inputs", "an unknown tensor or one twice", f"each of {', '.join(wanted)} once")
        where = f"inputs {tensor.name}"
        datatype = DATATYPES[tensor.dtype]
        if given.datatype != datatype:
            raise _fault(f"{where}.datatype", "another type", datatype)
        _check_shape(given.shape, tensor, where)
        if given.data is not None:
            array = _from_json(given.data, given.shape, datatype, where)
        else:
            array, raw = _from_raw(given, raw, datatype, where)
        if array.dtype.kind == "f" and not np.isfinite(array).all():
            at = [int(place) for place in np.argwhere(~np.isfinite(array))[0]]
            raise _fault(f"{where}{at}", "a number that is not finite in float32", "finite numbers")
        found[tensor.name] = array
    if len(raw):
        raise MalformedBodyError(f"body: received {len(raw)} bytes behind the last tensor; accepted is none")
    return found


def render(
    document: dict[str, Any], outputs: dict[str, Array], binary: frozenset[str]
) -> tuple[bytes, tuple[tuple[bytes, bytes], ...]]:
    """Body and headers of an answer: the document with these outputs, in order, some of them as raw bytes."""
    parts: list[dict[str, Any]] = []
    raw: list[bytes] = []
    for name, array in outputs.items():
        shown: dict[str, Any] = {"name": name, "datatype": "FP32", "shape": list(array.shape)}
        if name in binary:
            content = array.astype("<f4", copy=False).tobytes()
            shown["parameters"] = {"binary_data_size": len(content)}
            raw.append(content)
        else:
            shown["data"] = array.reshape(-1)
        parts.append(shown)
    json = orjson.dumps({**document, "outputs": parts}, option=orjson.OPT_SERIALIZE_NUMPY)
    if not raw:
        return json, ((b"content-type", b"application/json"),)
    length = (b"inference-header-content-length", str(len(json)).encode())
    return b"".join([json, *raw]), ((b"content-type", b"application/octet-stream"), length)


def _check_shape(shape: list[int], tensor: Tensor, where: str) -> None:
    accepted = ", ".join(str(size) if isinstance(size, int) else f"{size} (1 to {MAX_ROWS})" for size in tensor.shape)
    fits = len(shape) == len(tensor.shape) and all(
        1 <= given <= MAX_ROWS if isinstance(size, str) else given == size
        for given, size in zip(shape, tensor.shape, strict=True)
    )
    if not fits:
        raise _fault(f"{where}.shape", "another shape", f"[{accepted}]")


def _from_json(data: list[Any], shape: list[int], datatype: str, where: str) -> Array:
    """A list, nested as the shape says or flat, as an array."""
    flat = data
    if data and isinstance(data[0], list):
        for size in shape[1:]:
            if not all(isinstance(row, list) and len(row) == size for row in flat):
                raise _fault(f"{where}.data", "lists that do not nest as the shape says", f"shape {shape}, or flat")
            flat = list(itertools.chain.from_iterable(flat))
    if len(flat) != math.prod(shape):
        raise _fault(f"{where}.data", f"{len(flat)} values", f"{math.prod(shape)} values, as the shape says")
    if not set(map(type, flat)) <= _JSON_KINDS[datatype]:
        raise _fault(f"{where}.data", "a value that is no number of this type", f"{datatype} numbers")
    try:
        with np.errstate(over="ignore"):  # an infinity is refused with its place
            return np.array(flat, dtype=_DTYPES[datatype]).reshape(shape)
    except OverflowError as error:
        raise _fault(f"{where}.data", "a number that is too large", f"{datatype} numbers") from error


def _from_raw(given: InputPart, raw: memoryview, datatype: str, where: str) -> tuple[Array, memoryview]:
    """The next bytes as an array, and what follows them."""
    wanted = math.prod(given.shape) * _DTYPES[datatype].itemsize
    size = (given.parameters or {}).get("binary_data_size")
    if size is None:
        raise _fault(where, "neither data nor parameters.binary_data_size", "one of them")
    if isinstance(size, bool) or size != wanted:
        raise _fault(f"{where}.parameters.binary_data_size", "another size", f"{wanted}, as shape and type say")
    if len(raw) < wanted:
        raise _fault(where, f"{len(raw)} bytes", f"{wanted} bytes, as shape and type say")
    return np.frombuffer(raw[:wanted], dtype=_DTYPES[datatype]).reshape(given.shape), raw[wanted:]


def _fault(where: str, received: str, accepted: str) -> InvalidRequestError:
    return InvalidRequestError.at(where, received, accepted)


LENGTH_HEADER: Final = "inference-header-content-length"
