"""What a route may ask for: the models and threads of its app, an answer in JSON, and a key that covers it."""

from typing import Annotated

from fastapi import Request, Response, Security
from fastapi.security import HTTPAuthorizationCredentials, HTTPBearer

from service.errors import NotAcceptableError
from service.inference.query import Answer
from service.inference.readiness import Readiness
from service.inference.snapshot import Snapshot
from service.transport.keys import Keys, Scope, authorization_of
from service.transport.threads import Workers

_JSON_RANGES = frozenset(("*/*", "application/*", "application/json"))
_bearer = HTTPBearer(auto_error=False, description="an API key; `cazsl keys new` makes one")


def snapshot_of(request: Request) -> Snapshot:
    """What is served at this instant; a request uses one snapshot from beginning to end."""
    snapshot: Snapshot = request.app.state.models.snapshot
    return snapshot


def workers_of(request: Request) -> Workers:
    """The threads for what takes longer."""
    workers: Workers = request.app.state.workers
    return workers


def readiness_of(request: Request) -> Readiness:
    """What the probes found."""
    readiness: Readiness = request.app.state.readiness
    return readiness


def respond(request: Request, answer: Answer) -> Response:
    """The answer as it is, and what it was made by as a note for the log."""
    request.state.log = answer.notes
    headers = {name.decode(): value.decode() for name, value in answer.headers}
    return Response(answer.content, headers=headers)


async def takes_json(request: Request) -> None:
    """A dependency: the caller takes an answer in JSON.

    Raises:
        NotAcceptableError: its Accept header leaves JSON out.
    """
    accept = request.headers.get("accept")
    if accept is None:
        return
    for part in accept.split(","):
        media_range, *parameters = (text.strip().lower() for text in part.split(";"))
        refused = any(text.replace(" ", "") in ("q=0", "q=0.0", "q=0.00", "q=0.000") for text in parameters)
        if media_range in _JSON_RANGES and not refused:
            return
    raise NotAcceptableError


async def may_read_metrics(request: Request) -> None:
    """A dependency: the key covers metrics.

    Raises:
        MissingKeyError, ForbiddenError: it does not.
    """
    keys: Keys = request.app.state.keys
    keys.admit(authorization_of(request.scope["headers"]), Scope.METRICS)


async def may_predict(
    request: Request, _: Annotated[HTTPAuthorizationCredentials | None, Security(_bearer)] = None
) -> None:
    """A dependency: the key covers predictions and looking at models.

    Raises:
        MissingKeyError, ForbiddenError: it does not.
    """
    keys: Keys = request.app.state.keys
    keys.admit(authorization_of(request.scope["headers"]), Scope.PREDICT)
