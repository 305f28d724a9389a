"""Heads of requests, by RFC 9110 and 9112: fields that may come once only, and lists that may come in parts."""

import re
from typing import Final

from starlette.types import Scope

from service.errors import MalformedRequestError
from service.transport.endpoints import Headers, header

_ONCE: Final = frozenset(
    (b"host", b"authorization", b"content-type", b"content-length", b"inference-header-content-length")
)
_HOST: Final = re.compile(rb"(?:[A-Za-z0-9._~!$&'()*+,;=%-]*|\[[0-9A-Za-z:.%~_-]+\])(?::[0-9]*)?")
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
    if b"host" in fields:
        if not is_host(fields[b"host"]):
            raise MalformedRequestError(
                "header Host: received one that is none; accepted is a name, with or without port"
            )
    elif scope.get("http_version") == "1.1":
        raise MalformedRequestError("header Host: received none; accepted is the name of the service")
    return headers


def is_host(value: bytes) -> bool:
    """Return True if a value can be that of Host: a name or an address, with or without a port, or nothing."""
    return _HOST.fullmatch(value) is not None


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
