"""Heads of requests, by RFC 9110 and 9112: fields that may come once only, and lists that may come in parts."""

from typing import Final

from starlette.types import Scope

from service.errors import MalformedRequestError
from service.transport.endpoints import Headers, header

_ONCE: Final = frozenset(
    (b"host", b"authorization", b"content-type", b"content-length", b"inference-header-content-length")
)
_LINE_BYTES: Final = 4  # a colon, a space and the end of the line


def checked_headers(scope: Scope) -> Headers:
    """Return the headers of a request, each name once. The parts of a list are joined in their order.

    Raises:
        MalformedRequestError: a field that may come once comes twice, or HTTP/1.1 lacks its Host.
    """
    headers: Headers = scope["headers"]
    fields = dict(headers)
    if len(fields) != len(headers):
        headers = _joined(headers)
    if scope.get("http_version") == "1.1" and b"host" not in fields:
        raise MalformedRequestError("header Host: received none; accepted is the name of the service")
    return headers


def _joined(headers: Headers) -> Headers:
    fields: dict[bytes, bytes] = {}
    for name, value in headers:
        if name not in fields:
            fields[name] = value
        elif name in _ONCE:
            field = name.decode("ascii").title()
            raise MalformedRequestError(f"header {field}: received more than one; accepted is one")
        else:
            fields[name] += b", " + value
    return list(fields.items())


def declared_length(scope: Scope) -> int:
    """Return the declared length of the body in bytes, or 0 if none is declared."""
    length = header(scope["headers"], b"content-length")
    return int(length[:18]) if length is not None and length.isdigit() else 0


def head_bytes(scope: Scope) -> int:
    """Return about how many bytes the head of a request has."""
    return len(scope["path"]) + sum(len(name) + len(value) + _LINE_BYTES for name, value in scope["headers"])
