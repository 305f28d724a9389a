"""Everything that can go wrong, as one tree.

    CazslError
    ├── RequestError                   400  the caller sent something that cannot be answered
    │   ├── InvalidRequestError        422  a field is missing, mis-shaped, not finite or not allowed
    │   │   ├── ContextKindError       422  the model wants another kind of object context
    │   │   └── InvalidImageError      422  a picture is broken, cut off, animated, or more than a picture
    │   ├── MalformedBodyError         400  the body is not what it is declared to be: JSON, a form, tensors
    │   ├── MissingKeyError            401  an API key is needed and none, or an unknown one, came
    │   ├── ForbiddenError             403  the key does not cover this
    │   ├── UnknownModelError          404  no such model, version or alias
    │   ├── NotAcceptableError         406  the caller wants an answer in a form that we do not speak
    │   ├── SlowBodyError              408  the body did not arrive in time
    │   ├── BodyTooLargeError          413  the body is over the limit
    │   ├── ImageTooLargeError         413  a picture has too many bytes or pixels
    │   ├── UnsupportedMediaTypeError  415  the body is sent as something that we do not read
    │   ├── UnsupportedImageError      415  a picture is none of PNG, JPEG and WebP
    │   └── TooManyRequestsError       429  one caller has too many requests in flight
    ├── UnavailableError               503  come again later
    │   ├── ModelNotReadyError         503  the model exists but cannot serve now
    │   ├── OverloadedError            503  too much is being answered already
    │   └── DeadlineError              503  the answer was not ready in time
    ├── RegistryError                  500  the folder of models is not what it should be
    │   ├── BrokenModelError           500  a version fails verification: never served
    │   ├── PublishError               500  a version cannot be published; nothing became visible
    │   ├── ConflictError              500  somebody else changed it first; nothing was changed
    │   └── InUseError                 500  an alias names it; nothing was removed
    ├── PredictionError                500  the runtime failed, or gave what no model may give
    ├── SettingsError                       the operator set what is no setting, or cannot be (command line only)
    ├── DataError                           pushes on disk cannot be used, or results not be written (command line only)
    └── WorkforceError                      bulk work has nobody to do it: no Ray, or workers lost (command line only)

Each class carries a stable ``code``, an HTTP ``status`` and the words a client needs: what was received, what is
accepted, and where. Messages never hold a path of the server, a traceback, or the body that was sent.
Standard library only.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from http import HTTPStatus
from typing import Self


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

    @classmethod
    def at(cls, where: str, received: str, accepted: str) -> Self:
        """Create the error of one fault: the field, what was received, what is accepted."""
        return cls([FieldFault(where, received, accepted)])

    def __reduce__(self) -> tuple[type["InvalidRequestError"], tuple[tuple[FieldFault, ...]]]:
        """Travel between processes with the faults: an exception would by itself travel with its text."""
        return type(self), (self.faults,)


class InvalidImageError(InvalidRequestError):
    """A picture is broken, cut off, animated, or has something behind its end."""

    code = "invalid_image"
    title = "The picture cannot be used"


class MalformedBodyError(RequestError):
    """The body is not what it is declared to be: one JSON document in UTF-8, a form, or JSON and tensors."""

    code = "malformed_body"
    title = "The body cannot be read"


class MissingKeyError(RequestError):
    """The service wants an API key; what came is none, or none that it knows."""

    code = "missing_key"
    status = HTTPStatus.UNAUTHORIZED
    title = "An API key is needed"

    def __init__(self) -> None:
        super().__init__(
            "header Authorization: received no key that is known; accepted is 'Bearer ' and a key of this service"
        )


class ForbiddenError(RequestError):
    """The key is known and does not cover what was asked for."""

    code = "forbidden"
    status = HTTPStatus.FORBIDDEN
    title = "The key does not cover this"

    def __init__(self, scope: str) -> None:
        super().__init__(f"header Authorization: received a key without scope {scope}; accepted is one with it")


class NotAcceptableError(RequestError):
    """The answer would be in a form that the caller said it cannot take."""

    code = "not_acceptable"
    status = HTTPStatus.NOT_ACCEPTABLE
    title = "The answer has another form"

    def __init__(self, form: str = "application/json") -> None:
        super().__init__(f"header Accept: received one without {form}; accepted is {form}, */* or no such header")


class SlowBodyError(RequestError):
    """The body did not arrive in the time that it is given."""

    code = "slow_body"
    status = HTTPStatus.REQUEST_TIMEOUT
    title = "The body did not arrive in time"

    def __init__(self, limit_s: float) -> None:
        super().__init__(f"body: received a part of it in {limit_s:g} s; accepted is all of it in {limit_s:g} s")


class TooManyRequestsError(RequestError):
    """One caller has more requests in flight than its share."""

    code = "too_many_requests"
    status = HTTPStatus.TOO_MANY_REQUESTS
    title = "Too many requests at once"

    def __init__(self, limit: int) -> None:
        super().__init__(f"received more than {limit} requests at once; accepted is {limit} per caller, then wait")


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
    """The body is declared as something that this route does not read, or is compressed."""

    code = "unsupported_media_type"
    status = HTTPStatus.UNSUPPORTED_MEDIA_TYPE
    title = "The body is sent as something else"


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


class UnavailableError(CazslError):
    """Not now; trying again after a moment is right."""

    code = "unavailable"
    status = HTTPStatus.SERVICE_UNAVAILABLE
    title = "Not now"


class ModelNotReadyError(UnavailableError):
    """The model is known but not loaded, or no model is."""

    code = "model_not_ready"
    title = "The model is not ready"


class OverloadedError(UnavailableError):
    """More is being answered, or waits for it, than this process takes on."""

    code = "overloaded"
    title = "Too much to do"

    def __init__(self, what: str) -> None:
        super().__init__(f"the service has {what}; try again after Retry-After seconds")


class DeadlineError(UnavailableError):
    """The answer was not ready in the time that a request is given."""

    code = "deadline_exceeded"
    title = "The answer was not ready in time"

    def __init__(self, limit_s: float) -> None:
        super().__init__(f"the answer was not ready within {limit_s:g} s; send fewer pushes, or try again")


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


class SettingsError(CazslError):
    """A setting is unknown or impossible; the message names it and where it was set."""

    code = "settings"
    title = "The service cannot be started like this"


class DataError(CazslError):
    """Pushes on disk cannot be read or used; the message names the file and what was expected."""

    code = "data"
    title = "The data cannot be used"


class WorkforceError(CazslError):
    """Bulk work has nobody to do it: what it needs is not installed, no cluster answers, or its workers were lost."""

    code = "workforce"
    title = "Nobody can do the work"
