"""The fast path: answers requests to endpoints without the web framework, and single pushes without ASGI.

``FastPath`` is the ring in front of the framework. It answers requests to endpoints, and passes other requests on.
``Shortcut`` answers plain single pushes for connections, without the task and the messages that ASGI needs. Both use
the same ``Endpoints``, so their answers are the same to the byte.
"""

import asyncio
import time
from collections.abc import Callable, Coroutine, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, Final

from starlette.requests import ClientDisconnect
from starlette.types import ASGIApp, Receive, Scope, Send

from service.background.supervision import ENDINGS
from service.errors import CazslError, SlowBodyError
from service.inference.micro_batching import Outcome
from service.inference.query import Answer, Query
from service.observability.records import RequestRecord, record_of
from service.observability.telemetry import RequestTelemetry, id_header
from service.transport.admission import Admission
from service.transport.callers import caller_of
from service.transport.endpoints import NO_PARAMETERS, Endpoint, Endpoints, Headers, HttpRequest
from service.transport.heads import is_host
from service.transport.problems import problem_response

Reply = Callable[[int, Headers, bytes], None]
Leave = Callable[[], None]
_OK: Final = 200
_REPEATS: Final = 2
_PLAIN_ACCEPT: Final = frozenset((b"*/*", b"application/json"))
_IMAGE: Final = b'"image"'
_ESCAPE: Final = b"\\"  # may spell the name of a field
_MAX_BODY_BYTES: Final = 4096
"""Bytes of a body that is answered at once, among hundreds of others. A visual context in base64 has 1,400, and an
outline of 64 corners with all digits 3,000."""


class FastPath:
    """A ring that answers requests to endpoints, and passes other requests to the framework."""

    def __init__(self, app: ASGIApp, endpoints: Endpoints) -> None:
        self._app = app
        self._endpoints = endpoints

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one request."""
        is_post = scope["type"] == "http" and scope["method"] == "POST"
        found = self._endpoints.find(scope["path"]) if is_post else None
        if found is None:
            await self._app(scope, receive, send)
            return
        endpoint, parameters = found
        record = record_of(scope)
        record.route = endpoint.path
        content = (await receive())["body"]  # all of it: admission has read it
        try:
            asked = HttpRequest(scope["headers"], content, parameters, caller_of(scope))
            if endpoint.is_read_quickly(asked):
                answer = await self._endpoints.answer(endpoint, asked)
            else:
                answer = await until_left(self._endpoints.answer(endpoint, asked), receive)
        except ClientDisconnect:
            return
        except CazslError as error:
            await problem_response(scope, error)(scope, receive, send)
            return
        note_answer(record, answer)
        await send({"type": "http.response.start", "status": _OK, "headers": answer.head()})
        await send({"type": "http.response.body", "body": answer.content})


async def until_left(answer: Coroutine[Any, Any, Answer], receive: Receive) -> Answer:
    """Return an answer that takes long, which is cancelled if its client leaves.

    Raises:
        ClientDisconnect: the client has left.
    """
    working, leaving = asyncio.ensure_future(answer), asyncio.ensure_future(_left(receive))
    try:
        await asyncio.wait((working, leaving), return_when=asyncio.FIRST_COMPLETED)
        if not working.done():
            raise ClientDisconnect
        return working.result()
    finally:
        leaving.cancel()
        working.cancel()


async def _left(receive: Receive) -> None:
    """Return once the client has left. The server may repeat the end of the body before it tells."""
    for _ in range(_REPEATS):
        if (await receive())["type"] == "http.disconnect":
            return
    await asyncio.Event().wait()


def note_answer(record: RequestRecord, answer: Answer) -> None:
    """Note the model of an answer in the record of the request."""
    record.model, record.version, record.pushes = answer.model, answer.version, answer.pushes


@dataclass(slots=True)
class ShortcutRequest:
    """A request that the shortcut may answer once its body is complete."""

    scope: Scope
    caller: str
    began_s: float
    body: bytes = b""


class Shortcut:
    """The shortcut: answers plain single pushes for connections.

    A connection submits a complete request, and gets the answer at the end of the event loop iteration, together with
    the other pushes of that iteration. If a head is unusual, or the push has an image or a shape that was not seen
    before, the request is passed to the framework unchanged.
    """

    def __init__(
        self, endpoint: Endpoint[Any], endpoints: Endpoints, admission: Admission, telemetry: RequestTelemetry
    ) -> None:
        self._endpoint = endpoint
        self._target = endpoint.path.encode()
        self._longest = min(_MAX_BODY_BYTES, admission.body_bytes)
        self._endpoints = endpoints
        self._admission = admission
        self._telemetry = telemetry

    def open(self, target: bytes, scope: Scope, fields: Mapping[bytes, bytes], length: int) -> ShortcutRequest | None:
        """Return the request of the head of a POST to this target, or None if the head is unusual.

        Args:
            target: target of the request.
            scope: its scope.
            fields: its headers by name, the last of each.
            length: length of its body in bytes.
        """
        if (
            target != self._target
            or not 0 < length <= self._longest
            or len(fields) != len(scope["headers"])
            or not _is_plain(fields)
        ):
            return None
        scope["path"] = self._endpoint.path  # uvicorn sets it only for requests that it passes to the application
        caller = self._admission.known_caller(scope)
        return None if caller is None else ShortcutRequest(scope, caller, time.perf_counter())

    def answer(self, request: ShortcutRequest, reply: Reply, leave: Leave) -> None:
        """Answer a complete request at the end of this iteration, or pass it to the framework now by calling ``leave``.

        Refusals wait for the end of the iteration too: a client that sends many requests at once must not hold the
        event loop with refusals.
        """
        content = request.body
        if _IMAGE in content or _ESCAPE in content:  # an image is decoded in a thread, so it is not read here
            leave()
            return
        record = self._telemetry.begin(request.scope)
        try:
            query = self._query(request, record)
        except ENDINGS:
            raise
        except BaseException as error:
            self._endpoints.micro_batcher.fail(error, partial(self._refuse, request, record, reply))
            return
        if query is None:
            leave()
        else:
            self._endpoints.micro_batcher.submit(query, partial(self._settle, request, record, reply, query))

    def refuse_late(self, request: ShortcutRequest, reply: Reply) -> None:
        """Answer a request whose body is late."""
        record = self._telemetry.begin(request.scope)
        record.route = self._endpoint.path
        self._refuse(request, record, reply, SlowBodyError(self._admission.body_s))

    def _query(self, request: ShortcutRequest, record: RequestRecord) -> Query | None:
        record.route = self._endpoint.path
        self._admission.check(request.caller)
        asked = HttpRequest(request.scope["headers"], request.body, NO_PARAMETERS, request.caller)
        return self._endpoints.query_single(self._endpoint, asked)

    def _settle(
        self, request: ShortcutRequest, record: RequestRecord, reply: Reply, query: Query, outcome: Outcome
    ) -> None:
        """Answer with the prediction of a query, or with its error."""
        if isinstance(outcome, BaseException):
            self._refuse(request, record, reply, outcome)
            return
        found, warnings, seconds = outcome
        record.timings.append(("inference", seconds))
        try:
            answer = query.encode(found, warnings)
        except ENDINGS:
            raise
        except BaseException as error:  # a bug here must not leave the client without an answer
            self._refuse(request, record, reply, error)
            return
        note_answer(record, answer)
        self._end(request, record, reply, _OK, answer.head(), answer.content)

    def _refuse(self, request: ShortcutRequest, record: RequestRecord, reply: Reply, error: BaseException) -> None:
        """Answer with a problem."""
        response = problem_response(request.scope, error)
        self._end(request, record, reply, response.status_code, response.raw_headers, bytes(response.body))

    def _end(
        self,
        request: ShortcutRequest,
        record: RequestRecord,
        reply: Reply,
        status: int,
        headers: Headers,
        content: bytes,
    ) -> None:
        reply(status, (*headers, id_header(record)), content)
        record.status = status
        self._telemetry.end(record, time.perf_counter() - request.began_s)


def _is_plain(fields: Mapping[bytes, bytes]) -> bool:
    """Return True if headers that come once each declare a JSON body and are otherwise usual."""
    return (
        fields.get(b"content-type") == b"application/json"
        and fields.get(b"accept", b"*/*") in _PLAIN_ACCEPT
        and b"content-encoding" not in fields
        and b"expect" not in fields
        and is_host(fields.get(b"host", b"/"))
    )
