"""Errors of the clients, a branch of the error tree in ``service.errors``.

    CazslError
    └── ClientError
        ├── ProblemError           the service refused the request: status, code, detail and faults
        ├── UnreachableError       there was no answer, or the connection broke
        │   └── TimedOutError      the answer did not arrive in time
        ├── UnreadableAnswerError  the answer is not that of a CAZSL service
        └── ClientSetupError       an address, a key, or a proxy or certificate of the environment, is unusable

Standard library only.
"""

from collections.abc import Sequence

from service.errors import CazslError, FieldFault, InvalidRequestError


class ClientError(CazslError):
    """Root of all errors that a client raises."""

    code = "client"
    title = "The call failed"


class ProblemError(ClientError):
    """A request that the service refused, or that the client refused before sending it.

    Attributes:
        status: the HTTP status. 422 if the client refused the request before sending it.
        code: stable code of the problem, such as ``unknown_model``. docs/api.md lists codes, causes and remedies.
        title: the kind of problem in words.
        detail: the field, the received value and the accepted values.
        faults: all faults of the request, each with its field.
        request_id: id of the request in the service's log. Empty if it was not sent.
        retry_after_s: pause that the service asked for, in s, or None.
    """

    def __init__(
        self,
        code: str,
        detail: str,
        status: int,
        title: str = "",
        faults: Sequence[FieldFault] = (),
        request_id: str = "",
        retry_after_s: float | None = None,
    ) -> None:
        self.code = code
        self.detail = detail
        self.status = status  # type: ignore[assignment]  # any number may come, not only those with a name
        self.title = title
        self.faults = tuple(faults)
        self.request_id = request_id
        self.retry_after_s = retry_after_s
        super().__init__(f"{status} {code}: {detail}")

    @classmethod
    def at(cls, where: str, received: str, accepted: str) -> "ProblemError":
        """Create the error of an argument that JSON cannot represent, as the service would report it."""
        fault = FieldFault(where, received, accepted)
        kind = InvalidRequestError
        return cls(kind.code, str(fault), int(kind.status), kind.title, [fault])


class UnreachableError(ClientError):
    """There was no answer, or the connection broke. The service may have handled the request."""

    code = "unreachable"
    title = "The service cannot be reached"


class TimedOutError(UnreachableError):
    """The answer did not arrive within the timeout."""

    code = "timed_out"
    title = "The answer did not arrive in time"


class UnreadableAnswerError(ClientError):
    """The answer is not that of a CAZSL service: not JSON, other fields, missing numbers, or too large."""

    code = "unreadable_answer"
    title = "The answer cannot be read"


class ClientSetupError(ClientError):
    """The client cannot be created: its address, key, or a proxy or certificate of the environment, is unusable."""

    code = "client_setup"
    title = "The client cannot be set up"
