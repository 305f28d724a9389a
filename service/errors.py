"""Everything that can go wrong, as one tree.

    CazslError
    ├── RequestError                   400  the caller sent something that cannot be answered
    │   ├── InvalidRequestError        422  a field is missing, mis-shaped, not finite or not allowed
    │   │   └── InvalidImageError      422  a picture is broken, cut off, animated, or more than a picture
    │   ├── MalformedBodyError         400  the body is not a JSON document
    │   ├── BodyTooLargeError          413  the body is over the limit
    │   ├── ImageTooLargeError         413  a picture has too many bytes or pixels
    │   ├── UnsupportedMediaTypeError  415  the body is not sent as application/json
    │   ├── UnsupportedImageError      415  a picture is none of PNG, JPEG and WebP
    │   ├── UnknownModelError          404  no such model, version or alias
    │   └── ContextKindError           422  the model wants another kind of object context
    ├── ModelNotReadyError             503  the model exists but cannot serve now
    ├── RegistryError                  500  the folder of models is not what it should be
    │   ├── BrokenModelError           500  a version fails verification: never served
    │   ├── PublishError               500  a version cannot be published; nothing became visible
    │   ├── ConflictError              500  somebody else changed it first; nothing was changed
    │   └── InUseError                 500  an alias names it; nothing was removed
    ├── PredictionError                500  the runtime failed, or gave what no model may give
    └── DataError                           pushes on disk cannot be trained on (trainer only)

Each class carries a stable ``code``, an HTTP ``status`` and the words a client needs: what was received, what is
accepted, and where. Messages never hold a path of the server, a traceback, or the body that was sent.
Standard library only.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from http import HTTPStatus


@dataclass(frozen=True)
class FieldFault:
    """One fault in a request: where it is, what came, what would be taken."""

    where: str
    received: str
    accepted: str

    def __str__(self) -> str:
        return f"{self.where}: received {self.received}; accepted is {self.accepted}"


class CazslError(Exception):
    """Root of every error that this project raises on purpose."""

    code = "internal"
    status = HTTPStatus.INTERNAL_SERVER_ERROR
    title = "Something failed on our side"


class RequestError(CazslError):
    """The caller can mend it."""

    code = "bad_request"
    status = HTTPStatus.BAD_REQUEST
    title = "The request cannot be answered"


class InvalidRequestError(RequestError):
    """One or more fields are missing, mis-shaped, not finite or not allowed."""

    code = "invalid_request"
    status = HTTPStatus.UNPROCESSABLE_ENTITY
    title = "The request is not valid"

    def __init__(self, faults: Sequence[FieldFault]) -> None:
        self.faults = tuple(faults)
        super().__init__("; ".join(str(fault) for fault in self.faults))


class InvalidImageError(InvalidRequestError):
    """A picture is broken, cut off, animated, or has something behind its end."""

    code = "invalid_image"
    title = "The picture cannot be used"


class MalformedBodyError(RequestError):
    """The body is not one JSON document in UTF-8."""

    code = "malformed_body"
    title = "The body is not JSON"


class BodyTooLargeError(RequestError):
    """The body is over the limit, whatever its declared length said."""

    code = "body_too_large"
    status = HTTPStatus.REQUEST_ENTITY_TOO_LARGE
    title = "The body is too large"

    def __init__(self, limit_bytes: int) -> None:
        self.limit_bytes = limit_bytes
        super().__init__(f"body: received more than {limit_bytes} bytes; accepted is up to {limit_bytes} bytes")


class ImageTooLargeError(RequestError):
    """A picture has more bytes, pixels or pixels on a side than is taken; told before anything is decoded."""

    code = "image_too_large"
    status = HTTPStatus.REQUEST_ENTITY_TOO_LARGE
    title = "The picture is too large"

    def __init__(self, where: str, received: str, accepted: str) -> None:
        super().__init__(str(FieldFault(where, received, accepted)))


class UnsupportedMediaTypeError(RequestError):
    """The body is declared as something other than JSON."""

    code = "unsupported_media_type"
    status = HTTPStatus.UNSUPPORTED_MEDIA_TYPE
    title = "The body is not sent as JSON"


class UnsupportedImageError(RequestError):
    """A picture is of another format than PNG, JPEG and WebP, or of a variety of these that nobody sends."""

    code = "unsupported_image"
    status = HTTPStatus.UNSUPPORTED_MEDIA_TYPE
    title = "The picture is of another format"


class UnknownModelError(RequestError):
    """No such model, version or alias is served."""

    code = "unknown_model"
    status = HTTPStatus.NOT_FOUND
    title = "There is no such model"


class ContextKindError(InvalidRequestError):
    """The model that was asked for wants another kind of object context."""

    code = "wrong_context_kind"
    title = "The model wants another kind of context"


class ModelNotReadyError(CazslError):
    """The model is known but not loaded, or no model is."""

    code = "model_not_ready"
    status = HTTPStatus.SERVICE_UNAVAILABLE
    title = "The model is not ready"


class RegistryError(CazslError):
    """The folder of models is missing, unreadable, or asked for something it must not do."""

    code = "registry"
    title = "The registry refused"


class BrokenModelError(RegistryError):
    """A version does not pass verification."""

    code = "broken_model"
    title = "The model version does not pass verification"


class PublishError(RegistryError):
    """A version could not be published; nothing became visible."""

    code = "publish"
    title = "The version was not published"


class ConflictError(RegistryError):
    """What was to be changed is not what the caller saw; nothing was changed."""

    code = "conflict"
    title = "Somebody else changed it first"


class InUseError(RegistryError):
    """A version that an alias names cannot be removed."""

    code = "in_use"
    title = "The version is in use"


class PredictionError(CazslError):
    """The runtime failed, or its answer breaks the contract (not finite, std not positive)."""

    code = "prediction"
    title = "The prediction failed"


class DataError(CazslError):
    """Pushes on disk cannot be read or trained on; the message names the file and what was expected."""

    code = "data"
    title = "The data cannot be used"
