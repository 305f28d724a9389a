"""Endpoints of ``/v1``: how their requests are checked, read, weighed and turned into queries."""

import re
from typing import Any, Final

from starlette.datastructures import Headers as HeadersByName

from service.api.v1.object_contexts import is_light
from service.api.v1.queries import ContextRequest, ImageRequest, ask_batch, ask_image, ask_single, describe_view
from service.api.v1.uploads import Upload, read_upload
from service.errors import NotAcceptableError, UnsupportedMediaTypeError
from service.schemas.body import parse_body, validate_body
from service.schemas.pushes import BatchRequest, PredictRequest
from service.schemas.shapes import DETAILS, ShapeDetails
from service.transport.endpoints import LIGHT_BYTES, Endpoint, Headers, HttpRequest, Weight, header

LIGHT_CONTEXTS: Final = 256  # encoded in the event loop
LIGHT_BATCH_BYTES: Final = 64 * 1024  # 1,000 pushes: read in a tenth of the time that the runtime takes to predict them
_UPLOAD_GROWTH: Final = 4
_JSON: Final = b"application/json"
_JSON_RANGE: Final = re.compile(  # one search, because a header may have thousands of media ranges
    rb"(?i)(?:^|,)[ \t]*(?:\*/\*|application/\*|application/json)[ \t]*(?=[,;]|$)"
    rb"(?![^,]*;[ \t]*q[ \t]*=[ \t]*0(?:\.0{1,3})?[ \t]*(?:[,;]|$))"
)


def check_accept(headers: Headers) -> None:
    """Accept a request whose answer may be JSON.

    Raises:
        NotAcceptableError: its Accept header excludes JSON.
    """
    accept = header(headers, b"accept")
    if accept is None or accept in (b"*/*", _JSON):
        return
    if not _JSON_RANGE.search(accept):
        raise NotAcceptableError


def check_plain(headers: Headers) -> None:
    """Accept a request with a plain body, whose answer may be JSON.

    Raises:
        NotAcceptableError: see ``check_accept``.
        UnsupportedMediaTypeError: the body is compressed.
    """
    check_accept(headers)
    if header(headers, b"content-encoding") is not None:
        raise UnsupportedMediaTypeError(
            "header Content-Encoding: received a compressed body; accepted is a plain body without this header"
        )


def check_json(headers: Headers) -> None:
    """Accept a request with a body in JSON, whose answer may be JSON.

    Raises:
        NotAcceptableError, UnsupportedMediaTypeError: see ``check_plain``, or the body is not declared as JSON.
    """
    check_plain(headers)
    content_type = header(headers, b"content-type")
    if content_type != _JSON and not _is_json((content_type or b"").decode("latin-1")):
        raise UnsupportedMediaTypeError(
            "header Content-Type: received another type or none; accepted is application/json"
        )


def _is_json(content_type: str) -> bool:
    media_type = content_type.partition(";")[0].strip().lower()
    return media_type == "application/json" or (media_type.startswith("application/") and media_type.endswith("+json"))


def _read_single(request: HttpRequest) -> PredictRequest:
    return parse_body(PredictRequest, request.content)


def _read_batch(request: HttpRequest) -> BatchRequest:
    return parse_body(BatchRequest, request.content)


def _read_upload(request: HttpRequest) -> Upload:
    return read_upload(HeadersByName(raw=list(request.headers)), request.content)


def _read_image_request(request: HttpRequest) -> ImageRequest:
    upload = _read_upload(request)
    kind: type[BatchRequest] | type[PredictRequest] = BatchRequest if "pushers" in upload.fields else PredictRequest
    fields = {name: value for name, value in upload.fields.items() if name not in DETAILS}
    pushes: BatchRequest | PredictRequest = validate_body(kind, fields)
    return ImageRequest(pushes, upload.image, _read_details(upload))


def _read_context_request(request: HttpRequest) -> ContextRequest:
    upload = _read_upload(request)
    return ContextRequest(upload.image, _read_details(upload))


def _read_details(upload: Upload) -> ShapeDetails:
    return validate_body(ShapeDetails, {name: value for name, value in upload.fields.items() if name in DETAILS})


def _upload_bytes(request: HttpRequest) -> int:
    """Return the memory of an upload: a form is read in copies. Most of it is an image, which stays as it is."""
    return _UPLOAD_GROWTH * len(request.content)


def _weigh_single(request: PredictRequest) -> Weight:
    return Weight.SINGLE if request.context is None or is_light(request.context) else Weight.HEAVY


def _weigh_batch(request: BatchRequest) -> Weight:
    contexts = request.contexts or ()
    return Weight.LIGHT if len(contexts) <= LIGHT_CONTEXTS and all(map(is_light, contexts)) else Weight.HEAVY


SINGLE: Final = Endpoint(
    "/v1/predict",
    check=check_json,
    read=_read_single,
    ask=ask_single,
    weigh=_weigh_single,
    is_read_quickly=lambda request: len(request.content) <= LIGHT_BYTES,
)
BATCH: Final = Endpoint(
    "/v1/predict/batch",
    check=check_json,
    read=_read_batch,
    ask=ask_batch,
    weigh=_weigh_batch,
    is_read_quickly=lambda request: len(request.content) <= LIGHT_BATCH_BYTES,
)
IMAGE: Final = Endpoint(
    "/v1/predict/image",
    check=check_plain,
    read=_read_image_request,
    ask=ask_image,
    weigh=lambda _: Weight.HEAVY,
    is_read_quickly=lambda _: False,
    held_bytes=_upload_bytes,
)
CONTEXTS: Final = Endpoint(
    "/v1/contexts",
    check=check_plain,
    read=_read_context_request,
    ask=describe_view,
    weigh=lambda _: Weight.HEAVY,
    is_read_quickly=lambda _: False,
    held_bytes=_upload_bytes,
)
ENDPOINTS: Final[tuple[Endpoint[Any], ...]] = (SINGLE, BATCH, IMAGE, CONTEXTS)
