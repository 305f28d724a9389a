"""Framing: where the head and the body of a request end (RFC 9112).

llhttp judges every byte of a request, and cannot stop behind one. The ends are found here, and it is fed up to them:
bytes of the next request wait until this one is answered. If the two disagree, the request is refused.
"""

import re
from collections.abc import Sequence
from typing import Final

import httptools

from service.errors import MalformedRequestError

MAX_TARGET_BYTES: Final = 4096  # to split a query takes half a millisecond per KiB
MAX_HEADERS: Final = 128  # a short one takes fifty times its bytes in memory
MAX_FRAMING_BYTES: Final = 16 * 1024
_LINE_END: Final = b"\r\n"
_EMPTY_LINE: Final = b"\r\n\r\n"
_STRADDLE: Final = len(_EMPTY_LINE) - 1
_OFFER: Final = (b"upgrade", b"http2-settings")
_SIZE: Final = re.compile(rb"([0-9A-Fa-f]{1,16})(?:;[^\r\n]*)?\r\n")
_TRAILER: Final = re.compile(rb"[!#$%&'*+.^_`|~0-9A-Za-z-]+:[\t -~\x80-\xff]*\r\n")


def end_of_head(before: bytes, data: bytes) -> int:
    """Return the offset in data behind the empty line that ends a head, or -1.

    Args:
        before: last bytes of the head that came before, see ``straddling``.
        data: next bytes.
    """
    if not before:
        found = data.find(_EMPTY_LINE)
        return -1 if found < 0 else found + len(_EMPTY_LINE)
    found = (before + data).find(_EMPTY_LINE)
    return -1 if found < 0 else found + len(_EMPTY_LINE) - len(before)


def straddling(before: bytes, data: bytes) -> bytes:
    """Return the last bytes of an incomplete head, in which an empty line may have begun."""
    return (before + data[-_STRADDLE:])[-_STRADDLE:]


def head_without_upgrade(method: bytes, url: bytes, version: str, headers: Sequence[tuple[bytes, bytes]]) -> bytes:
    """Return a complete head again, without its offer of another protocol."""
    lines = [b"%b %b HTTP/%b" % (method, url, version.encode("ascii"))]
    for name, value in headers:
        if name == b"connection":
            options = [option.strip() for option in value.split(b",")]
            kept = b", ".join(option for option in options if option.lower() not in _OFFER)
            lines.append(b"connection: " + kept)
        elif name not in _OFFER:
            lines.append(name + b": " + value)
    return b"\r\n".join((*lines, b"", b""))


def path_and_query(target: bytes) -> tuple[bytes, bytes] | None:
    """Return path and query of the target of a request, or None if it has none."""
    try:
        parsed = httptools.parse_url(target)
    except httptools.HttpParserInvalidURLError:
        return None
    return parsed.path or b"/", parsed.query or b""


def expects_100(headers: Sequence[tuple[bytes, bytes]]) -> bool:
    """Return True if the client awaits a word before it sends its body."""
    return any(name == b"expect" and value.lower() == b"100-continue" for name, value in headers)


class ChunkedBody:
    """Walk through a chunked body, piece by piece, to its end behind the trailers.

    Sizes of chunks, their extensions and trailers are bounded beside the content: they would cost time without a body.
    Trailers are read here and left out for the parser, which would obey some of them, such as ``connection: close``.
    """

    def __init__(self) -> None:
        self._line = b""  # begin of a line whose end has not come
        self._content_left = 0  # bytes of the chunk, with the end of its line
        self._in_trailers = False
        self._framing_left = MAX_FRAMING_BYTES

    def walk(self, data: bytes) -> tuple[int, int]:
        """Return the offsets behind the chunks, and behind the end of the body or -1 if it is not among these bytes.

        Raises:
            MalformedRequestError: a size or a trailer is not one, or there is more framing than content.
        """
        at = 0
        chunks = 0 if self._in_trailers else len(data)
        while at < len(data):
            if self._content_left:
                step = min(self._content_left, len(data) - at)
                self._content_left -= step
                at += step
                continue
            end = data.find(b"\n", at) + 1
            part = data[at:end] if end else data[at:]
            self._framing_left -= len(part)
            if self._framing_left < 0:
                raise MalformedRequestError(
                    f"body: received more than {MAX_FRAMING_BYTES} bytes of chunk sizes and trailers; "
                    f"accepted is up to {MAX_FRAMING_BYTES} bytes"
                )
            self._line += part
            at += len(part)
            if not end:
                continue
            was_in_trailers = self._in_trailers
            if self._ends():
                return chunks, at
            if self._in_trailers and not was_in_trailers:
                chunks = at
        return chunks, -1

    def _ends(self) -> bool:
        """Read a complete line. Return True if it ends the body."""
        line, self._line = self._line, b""
        if self._in_trailers:
            if line != _LINE_END and not _TRAILER.fullmatch(line):
                raise MalformedRequestError("body: received a trailer that is none; accepted is a name and its value")
            return line == _LINE_END
        found = _SIZE.fullmatch(line)
        if found is None:
            raise MalformedRequestError("body: received a chunk without a valid size; accepted is its size in hex")
        size = int(found[1], 16)
        self._in_trailers = size == 0
        self._content_left = size + len(_LINE_END) if size else 0
        self._framing_left += size
        return False
