"""The error tree: every error that this project raises on purpose.

    CazslError
    ├── RequestError                   400  the request cannot be answered as it was sent
    │   ├── InvalidRequestError        422  a field is missing, of the wrong shape, not finite or not allowed
    │   │   ├── ContextKindError       422  the model takes another kind of object context
    │   │   └── InvalidImageError      422  an image is broken, truncated, animated, or too costly to read
    │   ├── MalformedBodyError         400  the body is not the JSON, form or tensors that it is declared to be
    │   ├── MalformedRequestError      400  the head or the framing of the request is not HTTP
    │   ├── MissingKeyError            401  an API key is required, and none or an unknown one was sent
    │   ├── ForbiddenError             403  the API key lacks the scope
    │   ├── UnknownModelError          404  no such model, version or alias
    │   ├── NotAcceptableError         406  the Accept header excludes the content type of the answer
    │   ├── SlowBodyError              408  the body did not arrive in time
    │   ├── BodyTooLargeError          413  the body is over the limit
    │   ├── ImageTooLargeError         413  an image has too many bytes or pixels
    │   ├── UnsupportedMediaTypeError  415  the content type or encoding of the body is not supported
    │   ├── UnsupportedImageError      415  an image is not PNG, JPEG or WebP
    │   └── TooManyRequestsError       429  one caller has too many requests in flight
    ├── UnavailableError               503  retry later
    │   ├── ModelNotReadyError         503  the model exists but cannot serve now
    │   ├── OverloadedError            503  too many requests or bytes are being handled
    │   └── DeadlineError              503  the answer was not ready in time
    ├── RegistryError                  500  the registry is missing, unreadable, or refuses an operation
    │   ├── BrokenModelError           500  a version fails verification and is never served
    │   ├── PublishError               500  a version cannot be published. It did not become visible
    │   ├── ConflictError              500  another writer changed it first. It stays as it is
    │   └── InUseError                 500  an alias names the version. It was not removed
    ├── PredictionError                500  the runtime failed, or its answer is not a Gaussian
    ├── SettingsError                       a setting is unknown or impossible (command line only)
    ├── DataError                           files of pushes or results cannot be read or written (command line only)
    └── WorkforceError                      bulk work has no executor: no Ray, or workers were lost (command line only)

Each class has a stable ``code``, an HTTP ``status`` and a ``title``. Messages name the field, the value that was
received and the values that are accepted. They never hold a path of the server, a traceback, or the body that was sent.
Standard library only.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from http import HTTPStatus
from typing import Any, Self


@dataclass(frozen=True)
class FieldFault:
    """One fault in a request: the field, a description of the received value, and the values that are accepted."""

    where: str
    received: str
    accepted: str

    def __str__(self) -> str:
        return f"{self.where}: received {self.received}; accepted is {self.accepted}"


class CazslError(Exception):
    """The root of the tree."""

    code, title = "internal", "Internal error"
    status = HTTPStatus.INTERNAL_SERVER_ERROR

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle text and attributes. By default an exception is pickled as a call with its text, which few take."""
        return _unpickled, (type(self), self.args, vars(self))


def _unpickled(kind: type[CazslError], texts: tuple[str, ...], attributes: dict[str, Any]) -> CazslError:
    error = kind.__new__(kind, *texts)
    vars(error).update(attributes)
    return error


class RequestError(CazslError):
    """The request cannot be answered as it was sent."""

    code, title = "bad_request", "Bad request"
    status = HTTPStatus.BAD_REQUEST


class InvalidRequestError(RequestError):
    """One or more fields are missing, mis-shaped, not finite or not allowed."""

    code, title = "invalid_request", "The request is not valid"
    status = HTTPStatus.UNPROCESSABLE_ENTITY

    def __init__(self, faults: Sequence[FieldFault]) -> None:
        self.faults = tuple(faults)
        super().__init__("; ".join(str(fault) for fault in self.faults))

    @classmethod
    def at(cls, where: str, received: str, accepted: str) -> Self:
        """Create the error of one fault: the field, the received value, the accepted values."""
        return cls([FieldFault(where, received, accepted)])


class InvalidImageError(InvalidRequestError):
    """An image is broken, truncated, animated, or has more parts than a picture needs."""

    code, title = "invalid_image", "The image is not valid"


class MalformedBodyError(RequestError):
    """The body is not the JSON document in UTF-8, form, or JSON with tensors that it is declared to be."""

    code, title = "malformed_body", "The body is malformed"


class MalformedRequestError(RequestError):
    """The head, or the framing of the body, is not HTTP as RFC 9110 and 9112 have it."""

    code, title = "malformed_request", "Bad Request"


class MissingKeyError(RequestError):
    """An API key is required, and none or an unknown one was sent."""

    code, title = "missing_key", "An API key is required"
    status = HTTPStatus.UNAUTHORIZED

    def __init__(self) -> None:
        super().__init__("header Authorization: received no known key; accepted is 'Bearer ' and a key of this service")


class ForbiddenError(RequestError):
    """The API key is known and lacks the scope of the route."""

    code, title = "forbidden", "The API key lacks the scope"
    status = HTTPStatus.FORBIDDEN

    def __init__(self, scope: str) -> None:
        super().__init__(f"header Authorization: received a key without scope {scope}; accepted is a key with it")


class NotAcceptableError(RequestError):
    """The Accept header excludes the content type of the answer."""

    code, title = "not_acceptable", "The content type is not acceptable"
    status = HTTPStatus.NOT_ACCEPTABLE

    def __init__(self) -> None:
        form = "application/json"
        super().__init__(f"header Accept: received types without {form}; accepted is {form}, */* or no such header")


class SlowBodyError(RequestError):
    """The body did not arrive in time."""

    code, title = "slow_body", "The body did not arrive in time"
    status = HTTPStatus.REQUEST_TIMEOUT

    def __init__(self, limit_s: float) -> None:
        super().__init__(f"body: received only a part within {limit_s:g} s; accepted is all of it within {limit_s:g} s")


class TooManyRequestsError(RequestError):
    """One caller has more requests in flight than its share."""

    code, title = "too_many_requests", "Too many requests"
    status = HTTPStatus.TOO_MANY_REQUESTS

    def __init__(self, limit: int) -> None:
        super().__init__(f"received more than {limit} concurrent requests; accepted is up to {limit} per caller")


class BodyTooLargeError(RequestError):
    """The body is over the limit, declared or counted."""

    code, title = "body_too_large", "The body is too large"
    status = HTTPStatus.REQUEST_ENTITY_TOO_LARGE

    def __init__(self, limit_bytes: int) -> None:
        self.limit_bytes = limit_bytes
        super().__init__(f"body: received more than {limit_bytes} bytes; accepted is up to {limit_bytes} bytes")


class ImageTooLargeError(RequestError):
    """An image has more bytes, pixels or pixels per side than the limit. Raised before pixels are decoded."""

    code, title = "image_too_large", "The image is too large"
    status = HTTPStatus.REQUEST_ENTITY_TOO_LARGE

    def __init__(self, where: str, received: str, accepted: str) -> None:
        super().__init__(str(FieldFault(where, received, accepted)))


class UnsupportedMediaTypeError(RequestError):
    """The body has a content type or an encoding that the route does not read."""

    code, title = "unsupported_media_type", "The content type is not supported"
    status = HTTPStatus.UNSUPPORTED_MEDIA_TYPE


class UnsupportedImageError(RequestError):
    """An image is not PNG, JPEG or WebP, or is a rare variety of these."""

    code, title = "unsupported_image", "The image format is not supported"
    status = HTTPStatus.UNSUPPORTED_MEDIA_TYPE


class UnknownModelError(RequestError):
    """No such model, version or alias is served."""

    code, title = "unknown_model", "Unknown model"
    status = HTTPStatus.NOT_FOUND


class ContextKindError(InvalidRequestError):
    """The model takes another kind of object context."""

    code, title = "wrong_context_kind", "The model takes another kind of context"


class UnavailableError(CazslError):
    """The request can be sent again after a moment."""

    code, title = "unavailable", "Temporarily unavailable"
    status = HTTPStatus.SERVICE_UNAVAILABLE


class ModelNotReadyError(UnavailableError):
    """The model is known but not loaded, or no model is."""

    code, title = "model_not_ready", "The model is not ready"


class OverloadedError(UnavailableError):
    """The requests or bytes in this process are over a limit."""

    code, title = "overloaded", "The service is overloaded"

    def __init__(self, limit: str) -> None:
        super().__init__(f"the service is at its limit of {limit}; retry after the Retry-After delay")


class DeadlineError(UnavailableError):
    """The answer was not ready in time."""

    code, title = "deadline_exceeded", "Deadline exceeded"

    def __init__(self, limit_s: float) -> None:
        super().__init__(f"the answer was not ready within {limit_s:g} s; send fewer pushes, or try again")


class RegistryError(CazslError):
    """The registry is missing, unreadable, or refuses an operation."""

    code, title = "registry", "Registry error"


class BrokenModelError(RegistryError):
    """A version does not pass verification."""

    code, title = "broken_model", "The model version does not pass verification"


class PublishError(RegistryError):
    """A version could not be published. It did not become visible."""

    code, title = "publish", "The version was not published"


class ConflictError(RegistryError):
    """Another writer changed it first. It stays as it is."""

    code, title = "conflict", "Another writer changed it first"


class InUseError(RegistryError):
    """A version that an alias names cannot be removed."""

    code, title = "in_use", "The version is in use"


class PredictionError(CazslError):
    """The runtime failed, or its answer is not a Gaussian: not finite, or a std that is not positive."""

    code, title = "prediction", "The prediction failed"


class SettingsError(CazslError):
    """A setting is unknown or impossible. The message names it and its source."""

    code, title = "settings", "The settings are not valid"


class DataError(CazslError):
    """Files of pushes or results cannot be read or written. The message names the file and the expectation."""

    code, title = "data", "The data cannot be used"


class WorkforceError(CazslError):
    """Bulk work has no executor: an extra is not installed, no cluster answers, or workers were lost."""

    code, title = "workforce", "No executor for bulk work"
