"""Tensors in the form of the Open Inference Protocol: JSON, or JSON followed by raw bytes.

The binary extension puts the tensors that have a ``binary_data_size`` behind the JSON, in the order of the JSON's list:
little-endian, row-major, no padding. Every size is compared with its expected value before memory is allocated.
Sources: Open Inference Protocol V2 (REST), and the binary tensor data extension.
"""

import itertools
import math
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import orjson

from service.api.open_inference.bodies import UNSUPPORTED, InferInputBody, InferRequestBody, Parameters
from service.errors import InvalidRequestError, MalformedBodyError
from service.model.tensors import Tensor
from service.schemas.body import parse_body
from service.schemas.rows import MAX_PUSHES

LENGTH_HEADER: Final = b"inference-header-content-length"
DATATYPES: Final = {"float32": "FP32", "int64": "INT64"}
_DTYPES: Final[dict[str, np.dtype[Any]]] = {"FP32": np.dtype("<f4"), "INT64": np.dtype("<i8")}
_JSON_KINDS: Final[dict[str, set[type]]] = {"FP32": {int, float}, "INT64": {int}}
Array = npt.NDArray[Any]


def read_json(content: bytes, header_length: str | None) -> tuple[InferRequestBody, memoryview]:
    """Read the JSON of a request. Return it with the bytes that follow.

    Raises:
        MalformedBodyError: the length in the header does not fit, or the bytes are not JSON.
        InvalidRequestError: a field is missing or not allowed, or a parameter is one of ``UNSUPPORTED``.
    """
    length = len(content)
    if header_length is not None:
        if not header_length.isascii() or not header_length.isdigit() or not 0 < int(header_length[:12]) <= length:
            accepted = f"the length of the JSON, 1 to {length} bytes"
            raise MalformedBodyError(
                f"header Inference-Header-Content-Length: received another value; accepted is {accepted}"
            )
        length = int(header_length[:12])
    body = parse_body(InferRequestBody, content[:length], prefix=())
    _check_supported("inputs", [tensor.parameters for tensor in body.inputs])
    _check_supported("outputs", [tensor.parameters for tensor in body.outputs or ()])
    return body, memoryview(content)[length:]


def read_inputs(part: InferRequestBody, raw: memoryview, expected: Sequence[Tensor]) -> dict[str, Array]:
    """Return input tensors by name, with the expected types and shapes and finite numbers. Inputs may be missing.

    Raises:
        InvalidRequestError: a tensor is unknown, repeated, of another type or shape, or not of its declared size.
        MalformedBodyError: bytes follow the last tensor.
    """
    wanted = {tensor.name: tensor for tensor in expected}
    found: dict[str, Array] = {}
    for given in part.inputs:
        tensor = wanted.get(given.name)
        if tensor is None or given.name in found:
            raise InvalidRequestError.at("inputs", "an unknown or repeated tensor", f"each of {', '.join(wanted)} once")
        where = f"inputs {tensor.name}"
        datatype = DATATYPES[tensor.dtype]
        if given.datatype != datatype:
            raise InvalidRequestError.at(f"{where}.datatype", "another type", datatype)
        _check_shape(given.shape, tensor, where)
        if given.data is not None:
            array = _from_json(given.data, given.shape, datatype, where)
        else:
            array, raw = _from_raw(given, raw, datatype, where)
        if array.dtype.kind == "f" and not np.isfinite(array).all():
            at = [int(place) for place in np.argwhere(~np.isfinite(array))[0]]
            raise InvalidRequestError.at(f"{where}{at}", "a number that is not finite in float32", "finite numbers")
        found[tensor.name] = array
    if len(raw):
        raise MalformedBodyError(f"body: received {len(raw)} bytes after the last tensor; accepted are none")
    return found


def render(
    document: dict[str, Any], outputs: dict[str, Array], binary: frozenset[str]
) -> tuple[bytes, tuple[tuple[bytes, bytes], ...]]:
    """Return body and headers of an answer: the document with these outputs in order, some of them as raw bytes."""
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
    length = (LENGTH_HEADER, str(len(json)).encode())
    return b"".join([json, *raw]), ((b"content-type", b"application/octet-stream"), length)


def _check_supported(field: str, found: Sequence[Parameters | None]) -> None:
    for number, parameters in enumerate(found):
        for name, accepted in UNSUPPORTED.items():
            if (parameters or {}).get(name) is not None:
                where = f"{field}.{number}.parameters.{name}"
                raise InvalidRequestError.at(where, "a parameter that is not supported", accepted)


def _check_shape(shape: list[int], tensor: Tensor, where: str) -> None:
    accepted = ", ".join(str(size) if isinstance(size, int) else f"{size} (1 to {MAX_PUSHES})" for size in tensor.shape)
    fits = len(shape) == len(tensor.shape) and all(
        1 <= given <= MAX_PUSHES if isinstance(size, str) else given == size
        for given, size in zip(shape, tensor.shape, strict=True)
    )
    if not fits:
        raise InvalidRequestError.at(f"{where}.shape", "another shape", f"[{accepted}]")


def _from_json(data: list[Any], shape: list[int], datatype: str, where: str) -> Array:
    """Return an array of a list that is flat, or nested like the shape."""
    flat = data
    if data and isinstance(data[0], list):
        for size in shape[1:]:
            if not all(isinstance(row, list) and len(row) == size for row in flat):
                raise InvalidRequestError.at(
                    f"{where}.data", "lists that are not nested like the shape", f"shape {shape}, or flat"
                )
            flat = list(itertools.chain.from_iterable(flat))
    if len(flat) != math.prod(shape):
        raise InvalidRequestError.at(
            f"{where}.data", f"{len(flat)} values", f"{math.prod(shape)} values, to fit the shape"
        )
    if not set(map(type, flat)) <= _JSON_KINDS[datatype]:
        raise InvalidRequestError.at(
            f"{where}.data", "a value that is not a number of this type", f"{datatype} numbers"
        )
    try:
        with np.errstate(over="ignore"):  # an infinity is refused later, with its position
            return np.array(flat, dtype=_DTYPES[datatype]).reshape(shape)
    except OverflowError as error:
        raise InvalidRequestError.at(f"{where}.data", "a number that is too large", f"{datatype} numbers") from error


def _from_raw(given: InferInputBody, raw: memoryview, datatype: str, where: str) -> tuple[Array, memoryview]:
    """Return the next bytes as an array, and the bytes that follow."""
    wanted = math.prod(given.shape) * _DTYPES[datatype].itemsize
    size = (given.parameters or {}).get("binary_data_size")
    if size is None:
        raise InvalidRequestError.at(where, "neither data nor parameters.binary_data_size", "one of the two")
    if isinstance(size, bool) or size != wanted:
        raise InvalidRequestError.at(
            f"{where}.parameters.binary_data_size", "another size", f"{wanted}, to fit shape and type"
        )
    if len(raw) < wanted:
        raise InvalidRequestError.at(where, f"{len(raw)} bytes", f"{wanted} bytes, to fit shape and type")
    return np.frombuffer(raw[:wanted], dtype=_DTYPES[datatype]).reshape(given.shape), raw[wanted:]
