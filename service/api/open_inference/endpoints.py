"""Endpoints of the Open Inference Protocol. Bodies may be compressed with gzip or deflate."""

import zlib
from functools import partial
from typing import Final

from service.api.open_inference.queries import InferRequest, ask_inference, parse_reference
from service.api.open_inference.wire import LENGTH_HEADER
from service.errors import BodyTooLargeError, MalformedBodyError, UnsupportedMediaTypeError
from service.transport.endpoints import BODY_GROWTH, LIGHT_BYTES, Endpoint, Headers, HttpRequest, Weight, header

MODEL_PATH: Final = "/v2/models/{name}/infer"
VERSION_PATH: Final = "/v2/models/{name}/versions/{version}/infer"
_MOST_INFLATED: Final = 1032  # times its size: zlib's limit
_WINDOW_BITS: Final = {"gzip": 16 + zlib.MAX_WBITS, "deflate": zlib.MAX_WBITS}


def inference_endpoints(max_body_bytes: int) -> tuple[Endpoint[InferRequest], ...]:
    """Return the endpoints for models and for versions. ``max_body_bytes`` bounds decompressed bodies."""
    return tuple(
        Endpoint(
            path,
            check=_check_nothing,
            read=partial(_read, max_body_bytes),
            ask=ask_inference,
            weigh=lambda _: Weight.LIGHT,  # a body that the event loop reads has few contexts
            is_read_quickly=_is_read_quickly,
            held_bytes=partial(_held_bytes, max_body_bytes),
        )
        for path in (MODEL_PATH, VERSION_PATH)
    )


def inflate(content: bytes, encoding: str, limit: int) -> bytes:
    """Decompress a body, up to a limit of bytes.

    Raises:
        UnsupportedMediaTypeError: the encoding is not gzip or deflate.
        MalformedBodyError: the body is not one complete stream of that encoding.
        BodyTooLargeError: the decompressed body is over the limit.
    """
    bits = _WINDOW_BITS.get(encoding.strip().lower())
    if bits is None:
        raise UnsupportedMediaTypeError(
            "header Content-Encoding: received another encoding; accepted is gzip or deflate"
        )
    stream = zlib.decompressobj(bits)
    try:
        found = stream.decompress(content, limit + 1)
    except zlib.error as error:
        raise MalformedBodyError(
            "body: received another encoding; accepted is one stream of the encoding in header Content-Encoding"
        ) from error
    if len(found) > limit:
        raise BodyTooLargeError(limit)
    if not stream.eof or stream.unused_data:
        raise MalformedBodyError("body: received half a stream, or more than one; accepted is one complete stream")
    return found


def _check_nothing(_: Headers) -> None:
    """Accept any headers: clients of the protocol send several content types."""


def _encoding(headers: Headers) -> str | None:
    """Return the encoding of a compressed body, or None for a plain body."""
    encoding = (header(headers, b"content-encoding") or b"identity").decode("latin-1")
    return None if encoding.lower() == "identity" else encoding


def _is_read_quickly(request: HttpRequest) -> bool:
    return len(request.content) <= LIGHT_BYTES and _encoding(request.headers) is None


def _held_bytes(max_body_bytes: int, request: HttpRequest) -> int:
    """Return the memory of a body once it is read: of one that is compressed, by the most that it can become."""
    size = len(request.content)
    if _encoding(request.headers) is not None:
        size = min(max_body_bytes, _MOST_INFLATED * size)
    return BODY_GROWTH * size


def _read(max_body_bytes: int, request: HttpRequest) -> InferRequest:
    content, encoding = request.content, _encoding(request.headers)
    if encoding is not None:
        content = inflate(content, encoding, max_body_bytes)
    reference = parse_reference(request.parameters["name"], request.parameters.get("version"))
    length = header(request.headers, LENGTH_HEADER)
    return InferRequest(reference, None if length is None else length.decode("latin-1"), content)
