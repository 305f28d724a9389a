"""What can go wrong for a client, as a branch of the one tree.

    CazslError
    └── ClientError
        ├── ProblemError           the service said no: its status, code, detail and faults
        ├── UnreachableError       nobody answered, or the connection broke
        ├── TimedOutError          the answer did not come in time
        └── UnreadableAnswerError  what came is no answer of this service

Standard library only.
"""

from collections.abc import Sequence

from service.errors import CazslError, FieldFault, InvalidRequestError


class ClientError(CazslError):
    """Root of what a client raises: one ``except`` for all of it."""

    code = "client"
    title = "The call failed"


class ProblemError(ClientError):
    """The service, or the client for it, refused to answer; ``code`` is stable, ``detail`` says what to mend.

    Attributes:
        status: the HTTP status; 422 where the client noticed before sending.
        code: of the problem, such as ``unknown_model``; docs/api.md lists them with cause and cure.
        title: the kind of problem in words.
        detail: what was received, what is accepted and where.
        faults: each fault of the request, with its place.
        request_id: under which the service logged it; empty where nothing was sent.
        retry_after_s: what the service asked to wait, in s, where it did.
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
    def unsendable(cls, where: str, received: str, accepted: str) -> "ProblemError":
        """What the service would say of an argument that JSON cannot even carry."""
        fault = FieldFault(where, received, accepted)
        kind = InvalidRequestError
        return cls(kind.code, str(fault), int(kind.status), kind.title, [fault])


class UnreachableError(ClientError):
    """Nobody answered, or the connection broke; whether the request was answered is not known."""

    code = "unreachable"
    title = "The service cannot be reached"


class TimedOutError(UnreachableError):
    """The answer did not come in the time that a call is given."""

    code = "timed_out"
    title = "The answer did not come in time"


class UnreadableAnswerError(ClientError):
    """What came is no answer of this service: no JSON, other fields, numbers missing, or without an end."""

    code = "unreadable_answer"
    title = "The answer cannot be read"
