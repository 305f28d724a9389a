"""The shortest way to a prediction: a connection has it answered, without a task or a message of ASGI for it.

Most of what a single push cost was the passing on of it: a task, its messages, the rings around the application. Here a
connection that has a whole request in hand asks at once, and gets the answer at the end of the turn of the event loop,
together with all others that came in it. Only a plain request for one push is taken, and only while nothing stands
against it; everything else takes the long way, which says what is wrong, and so gives the same bytes for every request.
"""

import logging
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Final

from pydantic import ValidationError
from starlette.types import Scope

from service.api.open_inference.queries import LIGHT_BYTES
from service.api.v1.queries import Question
from service.errors import CazslError
from service.inference.micro_batching import Gaussian
from service.observability.telemetry import RequestTelemetry
from service.transport.admission import Intake, declared_length
from service.transport.fast_path import SINGLE, FastPath, Headers

Reply = Callable[[Headers, bytes], None]
Leave = Callable[[], None]

logger = logging.getLogger(__name__)
_OK: Final = 200


@dataclass(slots=True)
class ShortRequest:
    """A request that may be answered here, once its body is whole."""

    scope: Scope
    began_s: float
    body: bytearray = field(default_factory=bytearray)


class ShortWay:
    """Answers single pushes for connections; with the fast path's doors and turns, the intake's limits, and a log."""

    def __init__(self, fast_path: FastPath, intake: Intake, telemetry: RequestTelemetry) -> None:
        self._fast_path = fast_path
        self._intake = intake
        self._telemetry = telemetry

    def open(self, target: bytes, scope: Scope) -> ShortRequest | None:
        """The beginning of a POST to this target; None when it takes the long way."""
        plain = self._fast_path.takes_single(target.decode("latin-1"), scope["headers"])
        if not plain or not 0 < declared_length(scope) <= LIGHT_BYTES:
            return None
        return ShortRequest(scope, time.perf_counter())

    def answer(self, request: ShortRequest, reply: Reply, leave: Leave) -> None:
        """Answer a whole request at the end of this turn, or have it leave for the long way, now or then."""
        question = self._question(request)
        if question is None:
            leave()
            return

        def tell(outcome: Gaussian | Exception) -> None:
            if isinstance(outcome, Exception):
                leave()
            else:
                self._tell(request, question, outcome, reply)

        self._fast_path.turns.ask(question, tell)

    def end_turn(self) -> None:
        """Answer what waits, now: a connection goes on to its next request."""
        self._fast_path.turns.end()

    def _question(self, request: ShortRequest) -> Question | None:
        try:
            if self._intake.refusal(request.scope) is not None:
                return None
            return self._fast_path.ask_single(bytes(request.body))
        except (ValidationError, CazslError):
            return None
        except Exception:  # a bug here must not cost the client its connection; the long way meets it, and answers 500
            logger.exception("the short way failed")
            return None

    def _tell(self, request: ShortRequest, question: Question, gaussian: Gaussian, reply: Reply) -> None:
        mean, std, seconds = gaussian
        answer = question.answered(mean, std)
        scope = request.scope
        request_id = self._telemetry.begin(scope)
        scope["state"]["log"] = {**answer.notes, "route": SINGLE}
        reply((*answer.head(), (b"x-request-id", request_id.encode())), answer.content)
        self._telemetry.note(scope, _OK, time.perf_counter() - request.began_s, [("inference", seconds)])
