"""Uploads: an image file with fields beside it as a form, or an image file alone. A thread reads them from memory.

python-multipart parses the form, piece by piece, and stops at the first fault. A form has a few parts. Its names decide
their meaning, and file names and media types do not: ``image`` is a file, and the other parts are text in UTF-8, in
JSON except for the model. A preamble before the first boundary and an epilogue behind the last one are skipped.
Admission has bounded its bytes already.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final

from python_multipart.exceptions import FormParserError
from python_multipart.multipart import MultipartParser, parse_options_header
from starlette.datastructures import Headers

from service.errors import InvalidRequestError, MalformedBodyError, UnsupportedMediaTypeError
from service.schemas.documents import parse_json
from service.schemas.shapes import DETAILS

IMAGE_TYPES: Final = ("image/png", "image/jpeg", "image/webp")
FORM_TYPE: Final = "multipart/form-data"
MAX_PREAMBLE_BYTES: Final = 1 << 16
MAX_HEADER_LENGTH: Final = 1000  # of the header Content-Type, whose parameters take a time quadratic in it
_JSON_FIELDS: Final = frozenset(("pusher", "pushers", "lengths", "object_pose", "object_poses", *DETAILS))
_FIELDS: Final = _JSON_FIELDS | {"model"}
_CHARSET_FIELD: Final = "_charset_"  # RFC 7578, section 4.6: browsers name the charset of all texts in it
_PARTS: Final = _FIELDS | {"image", _CHARSET_FIELD}
_CHARSETS: Final = frozenset(("", "utf-8", "utf8", "us-ascii", "ascii"))
_ASCII_WITHIN: Final = frozenset(("iso-8859-1", "latin1", "windows-1252"))  # declared by default, as Java's clients do
_PLAIN_ENCODINGS: Final = frozenset(("", "7bit", "8bit", "binary"))
_PIECE_BYTES: Final = 1 << 16


@dataclass(frozen=True)
class Upload:
    """Upload of an image file with the fields beside it. Fields in JSON are parsed, ``model`` is text."""

    image: bytes
    fields: dict[str, Any] = field(default_factory=dict)


def read_upload(headers: Headers, content: bytes) -> Upload:
    """Read the image and the fields of a body. Blocking: call it in a thread.

    Raises:
        UnsupportedMediaTypeError: the body is neither a form nor an image.
        MalformedBodyError: the form is not as RFC 7578 describes it, or has too many parts or parameters.
        InvalidRequestError: the form stops early, the image is missing, or a field is unknown, repeated, or not JSON.
    """
    content_type = headers.get("content-type", "")
    if len(content_type) > MAX_HEADER_LENGTH:
        received = f"a text of {len(content_type)} characters"
        raise MalformedBodyError(f"header Content-Type: received {received}; accepted are up to {MAX_HEADER_LENGTH}")
    media_type, options = _options(content_type)
    if media_type in IMAGE_TYPES:
        return Upload(content)
    if media_type != FORM_TYPE or options.get("charset", "").lower() not in _CHARSETS:
        accepted = ", ".join((f"{FORM_TYPE} in UTF-8", *IMAGE_TYPES))
        raise UnsupportedMediaTypeError(f"header Content-Type: received another type or none; accepted is {accepted}")
    boundary = options.get("boundary", "")
    if not boundary:
        raise MalformedBodyError("header Content-Type: received a form without a boundary; accepted is one with it")
    parts = _Form(boundary.encode("latin-1")).read(content)
    image = parts.pop("image", None)
    if image is None:
        raise InvalidRequestError.at("body.image", "no file", "a file: PNG, JPEG or WebP")
    if _text(_CHARSET_FIELD, parts.pop(_CHARSET_FIELD, b"")).lower() not in _CHARSETS:
        raise _other_charset(_CHARSET_FIELD)
    return Upload(image, {name: _value(name, data) for name, data in parts.items()})


class _Form:
    """Form whose parts are collected while it is parsed. Its headers are bounded by the parser."""

    def __init__(self, boundary: bytes) -> None:
        self._delimiter = b"--" + boundary
        self._parts: dict[str, bytes] = {}
        self._part: list[bytes] = []
        self._name, self._charset = "", ""
        self._headers: dict[str, str] = {}
        self._header = [b"", b""]
        self._ended, self._progress = False, 0

    def read(self, content: bytes) -> dict[str, bytes]:
        """Return the parts by name.

        Raises:
            MalformedBodyError, InvalidRequestError: see ``read_upload``.
        """
        try:
            parser = MultipartParser(
                self._delimiter[2:],
                {
                    "on_part_begin": self._begin_part,
                    "on_part_data": self._add_data,
                    "on_part_end": self._end_part,
                    "on_header_field": lambda data, start, end: self._add_header(0, data[start:end]),
                    "on_header_value": lambda data, start, end: self._add_header(1, data[start:end]),
                    "on_header_end": self._end_header,
                    "on_headers_finished": self._name_part,
                    "on_end": self._end,
                },
            )
            self._feed(parser, content)
        except FormParserError as error:
            accepted = "boundaries and headers by RFC 7578, in lines that end with CR LF"
            raise MalformedBodyError(f"body: received another kind of form; accepted are {accepted}") from error
        if content and not self._ended:
            received = "a form that stops before its last boundary"
            raise InvalidRequestError.at("body", received, "a whole form")
        return self._parts

    def _feed(self, parser: MultipartParser, content: bytes) -> None:
        """Write the content to the parser in pieces, because a search holds Python's lock until it ends."""
        delimiters = 0
        for start in range(self._first_delimiter(content), len(content), _PIECE_BYTES):
            piece, before = content[start : start + _PIECE_BYTES], self._progress
            delimiters += piece.count(self._delimiter)
            if delimiters > len(_PARTS) + 1:
                accepted = f"up to {len(_PARTS)}"
                raise MalformedBodyError(f"body: received a form of too many parts; accepted are {accepted}")
            parser.write(piece)
            if self._ended:
                return
            if self._progress == before:
                raise MalformedBodyError(
                    "body: received a form with a run of blanks; accepted is CR LF behind a boundary"
                )

    def _first_delimiter(self, content: bytes) -> int:
        if not content or content.startswith(self._delimiter):
            return 0
        found = content.find(b"\n" + self._delimiter, 0, MAX_PREAMBLE_BYTES)
        if found < 0:
            accepted = f"the boundary of the header Content-Type in the first {MAX_PREAMBLE_BYTES} bytes"
            raise MalformedBodyError(f"body: received a form with another boundary; accepted is {accepted}")
        return found + 1

    def _begin_part(self) -> None:
        self._part, self._headers = [], {}
        self._progress += 1

    def _add_header(self, side: int, data: bytes) -> None:
        self._header[side] += data
        self._progress += 1

    def _end_header(self) -> None:
        name, value = (text.decode("latin-1") for text in self._header)
        self._header = [b"", b""]
        if name.lower() in self._headers:
            raise MalformedBodyError("body: received a part with a repeated header; accepted is each header once")
        self._headers[name.lower()] = value

    def _name_part(self) -> None:
        """Read the headers of a part: its name, and the encoding of its data."""
        disposition, options = _options(self._headers.get("content-disposition", ""))
        if disposition != "form-data" or "name" not in options:
            accepted = 'Content-Disposition: form-data; name="..."'
            raise MalformedBodyError(f"body: received a part without a name; accepted is {accepted}")
        self._name = name = options["name"]
        if name not in _PARTS:
            raise InvalidRequestError.at("body", "an unknown part", f"the parts {', '.join(sorted(_PARTS))}")
        if name in self._parts:
            raise InvalidRequestError.at(f"body.{name}", "a second part of this name", "one part")
        if self._headers.get("content-transfer-encoding", "").strip().lower() not in _PLAIN_ENCODINGS:
            received, accepted = "an encoded part", "the bytes as they are, without Content-Transfer-Encoding"
            raise InvalidRequestError.at(f"body.{name}", received, accepted)
        self._charset = _options(self._headers.get("content-type", ""))[1].get("charset", "").lower()
        if name != "image" and self._charset not in _CHARSETS | _ASCII_WITHIN:
            raise _other_charset(name)
        self._progress += 1

    def _add_data(self, data: bytes, start: int, end: int) -> None:
        self._part.append(data[start:end])
        self._progress += 1

    def _end_part(self) -> None:
        self._parts[self._name] = data = b"".join(self._part)
        self._part = []
        if self._name != "image" and self._charset in _ASCII_WITHIN and not data.isascii():
            raise _other_charset(self._name)

    def _end(self) -> None:
        self._ended = True


def _options(header: str) -> tuple[str, Mapping[str, str]]:
    """Return the value of a header, and its parameters by name."""
    value, options = parse_options_header(header)
    return value.decode("latin-1"), {
        name.decode("latin-1").lower(): text.decode("latin-1") for name, text in options.items()
    }


def _value(name: str, data: bytes) -> Any:
    if name not in _JSON_FIELDS:
        return _text(name, data)
    try:
        return parse_json(data)
    except MalformedBodyError as error:
        received = "a text that is not JSON"
        raise InvalidRequestError.at(f"body.{name}", received, "JSON, as in POST /v1/predict") from error


def _text(name: str, data: bytes) -> str:
    try:
        return data.decode()
    except UnicodeDecodeError as error:
        raise _other_charset(name) from error


def _other_charset(name: str) -> InvalidRequestError:
    return InvalidRequestError.at(f"body.{name}", "a text in another charset", "UTF-8")
