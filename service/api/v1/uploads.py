"""Uploads: an image file with fields beside it as a form, or an image file alone. A thread reads them from memory.

python-multipart, through Starlette, parses the form, limited to one file and a few fields. It is never written to disk.
Admission has bounded its bytes already.
"""

import asyncio
from collections.abc import AsyncGenerator
from dataclasses import dataclass, field
from typing import Any, Final

from starlette.datastructures import Headers, UploadFile
from starlette.formparsers import MultiPartException, MultiPartParser

from service.errors import InvalidRequestError, MalformedBodyError, UnsupportedMediaTypeError
from service.schemas.documents import parse_json

IMAGE_TYPES: Final = ("image/png", "image/jpeg", "image/webp")
FORM_TYPE: Final = "multipart/form-data"
_JSON_FIELDS: Final = frozenset(("pusher", "pushers", "object_pose", "object_poses"))
_FIELDS: Final = _JSON_FIELDS | {"model"}


@dataclass(frozen=True)
class Upload:
    """Upload of an image file with the fields beside it. Fields in JSON are parsed, ``model`` is text."""

    image: bytes
    fields: dict[str, Any] = field(default_factory=dict)


class _InMemory(MultiPartParser):
    """Parser of forms that never writes to disk: a container may be read-only."""

    spool_max_size = 1 << 62

    def close(self) -> None:
        """Close every file. The parser itself does not close files whose end did not arrive."""
        for file in self._files_to_close_on_error:
            file.close()


def read_upload(headers: Headers, content: bytes) -> Upload:
    """Read the image and the fields of a body. Blocking: call it in a thread without an event loop.

    Raises:
        UnsupportedMediaTypeError: the body is neither a form nor an image.
        MalformedBodyError: the form is incomplete, or has too many parts.
        InvalidRequestError: the image is missing, or a field is unknown, repeated, or not JSON.
    """
    media_type = headers.get("content-type", "").partition(";")[0].strip().lower()
    if media_type in IMAGE_TYPES:
        return Upload(content)
    if media_type != FORM_TYPE or not _is_utf8(headers.get("content-type", "")):
        accepted = ", ".join((FORM_TYPE, *IMAGE_TYPES))
        raise UnsupportedMediaTypeError(f"header Content-Type: received another type or none; accepted is {accepted}")
    try:
        form = asyncio.run(_parse(headers, content))
    except (MultiPartException, KeyError, ValueError) as error:
        accepted = f"one file image and the fields {', '.join(sorted(_FIELDS))}, with the boundary of the header"
        raise MalformedBodyError(f"body: received another form; accepted is {accepted}") from error
    image: bytes | None = None
    fields: dict[str, Any] = {}
    for name, value in form:
        if name == "image" and image is None and isinstance(value, bytes):
            image = value
        elif name in _FIELDS and name not in fields and isinstance(value, str):
            fields[name] = _json(name, value) if name in _JSON_FIELDS else value
        else:
            accepted = f"a file image, and each of {', '.join(sorted(_FIELDS))} at most once, as text"
            raise InvalidRequestError.at(
                "body", "an unknown part, a repeated part, or a text in place of a file", accepted
            )
    if image is None:
        raise InvalidRequestError.at("body.image", "no file", "a file: PNG, JPEG or WebP")
    return Upload(image, fields)


async def _parse(headers: Headers, content: bytes) -> list[tuple[str, str | bytes]]:
    """Return the parts of a form, in order."""

    async def stream() -> AsyncGenerator[bytes, None]:
        """Yield the body in one part."""
        yield content

    parser = _InMemory(headers, stream(), max_files=1, max_fields=len(_FIELDS), max_part_size=len(content))
    try:
        form = await parser.parse()
        return [
            (name, await value.read() if isinstance(value, UploadFile) else value) for name, value in form.multi_items()
        ]
    finally:
        parser.close()


def _is_utf8(content_type: str) -> bool:
    """Return True if the charset of a form is UTF-8 or not declared. Some codecs of Python are slow by design."""
    parameters = content_type.lower().replace('"', "").replace(" ", "").split(";")
    return all(not text.startswith("charset") or text == "charset=utf-8" for text in parameters)


def _json(name: str, text: str) -> Any:
    try:
        return parse_json(text.encode())
    except MalformedBodyError as error:
        raise InvalidRequestError.at(
            f"body.{name}", "a text that is not JSON", "JSON, as in POST /v1/predict"
        ) from error
