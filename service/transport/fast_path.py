"""The short way to a prediction: from bytes to bytes without the web framework's machinery.

It answers what is in order, and nothing else: a request with an unusual header, a fault, or a model that is not there
goes on to the framework's routes as if this room did not exist, and they say what is wrong. Only what took too long and
what is no image are refused here: they would begin it again. The short way validates with the same schemas, asks the
same functions and holds the same bounds, so a test can demand that both give the same bytes for every request.
"""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final

from pydantic import ValidationError
from starlette.datastructures import Headers as HeadersByName
from starlette.types import ASGIApp, Receive, Scope, Send

from service.api.open_inference.queries import LIGHT_BYTES, InferRequest, ask_inference, infer
from service.api.open_inference.wire import LENGTH_HEADER
from service.api.v1.queries import (
    LIGHT_PUSHES,
    Question,
    ask_batch,
    ask_one,
    describe_upload,
    is_read_quickly,
    predict_batch,
    predict_one,
    predict_upload,
)
from service.api.v1.uploads import read_upload
from service.errors import CazslError, DeadlineError
from service.inference.loaded_models import LoadedModels
from service.inference.micro_batching import Turns
from service.inference.query import Answer, Asked
from service.inference.snapshot import Snapshot
from service.schemas.pushes import PredictRequest, read_batch
from service.transport.admission import WholeBody
from service.transport.keys import Keys
from service.transport.keys import Scope as KeyScope
from service.transport.problems import problem_response
from service.transport.threads import Workers

Headers = Sequence[tuple[bytes, bytes]]
SINGLE: Final = "/v1/predict"
LIGHT_BATCH_BYTES: Final = 64 * 1024  # 1,000 pushes: read in a tenth of the time that they take the runtime
_PLAIN_ACCEPT: Final = frozenset((b"*/*", b"application/json"))


@dataclass(frozen=True, slots=True)
class Door:
    """How the bodies of one route are read and answered."""

    path: str  # its template; named as the framework's routes name theirs
    parse: Callable[[bytes], Any]
    predict: Callable[[Snapshot, Any], Answer]
    ask: Callable[[Snapshot, Any], Asked] | None = None  # None of what is all work for a thread
    most_bytes: int = LIGHT_BYTES  # of a body that is read in the event loop
    json_only: bool = False  # of bodies that are declared otherwise the framework says what they are not

    def answer(self, models: Snapshot, content: bytes) -> Answer:
        """All of it in one go, for a thread."""
        return self.predict(models, self.parse(content))


DOORS: Final = {
    door.path: door
    for door in (
        Door(SINGLE, PredictRequest.__pydantic_validator__.validate_json, predict_one, ask_one, json_only=True),
        Door("/v1/predict/batch", read_batch, predict_batch, ask_batch, LIGHT_BATCH_BYTES, json_only=True),
    )
}
UPLOADS: Final = {"/v1/predict/image": predict_upload, "/v1/contexts": describe_upload}
_INFER_PATH: Final = re.compile(r"/v2/models/(?P<model>[a-z0-9@_-]{1,140})(?:/versions/(?P<version>[0-9]{1,9}))?/infer")
_INFER_ROUTES: Final = ("/v2/models/{name}/infer", "/v2/models/{name}/versions/{version}/infer")


class FastPath:
    """Answers plain predictions; passes on everything else."""

    def __init__(self, app: ASGIApp, models: LoadedModels, workers: Workers, keys: Keys) -> None:
        self._app = app
        self._models = models
        self._workers = workers
        self._keys = keys
        self.turns = Turns()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one request."""
        is_post = scope["type"] == "http" and scope["method"] == "POST"
        door = self._door(scope["path"], scope["headers"]) if is_post else None
        if door is None:
            await self._app(scope, receive, send)
            return
        content = (await receive())["body"]  # whole: the intake saw to it
        try:
            answer = await self._answer(door, content)
        except (ValidationError, CazslError) as error:
            if isinstance(error, DeadlineError) or (door.ask is None and isinstance(error, CazslError)):
                scope["route"] = door
                await problem_response(scope, error)(scope, receive, send)
            else:
                await self._app(scope, WholeBody(content, receive), send)
            return
        scope["state"]["log"] = {**answer.notes, "route": door.path}
        await send({"type": "http.response.start", "status": 200, "headers": answer.head()})
        await send({"type": "http.response.body", "body": answer.content})

    def takes_single(self, path: str, headers: Headers) -> bool:
        """Whether this is where single pushes go, and the headers ask for nothing that needs a second look."""
        return path == SINGLE and self._door(path, headers) is not None

    def ask_single(self, content: bytes) -> Question | None:
        """What a body of a single push asks; None when reading it takes too long for the event loop.

        Raises:
            ValidationError, CazslError: it is not in order.
        """
        request = DOORS[SINGLE].parse(content)
        return ask_one(self._models.snapshot, request) if is_read_quickly(request) else None

    async def _answer(self, door: Door, content: bytes) -> Answer:
        models = self._models.snapshot
        if door.ask is None or len(content) > door.most_bytes:
            return await self._workers.run(door.answer, models, content)
        request = door.parse(content)
        if not is_read_quickly(request):
            return await self._workers.run(door.predict, models, request)
        if isinstance(request, PredictRequest):
            return await self.turns.answer(ask_one(models, request))
        question = door.ask(models, request)
        if len(question.pushers) <= LIGHT_PUSHES:
            return question.answer()
        # the runtime alone in a thread: what is Python holds one lock wherever it runs, and gives it away at a price
        return question.answered(*await self._workers.run(question.predict))

    def _door(self, path: str, headers: Headers) -> Door | None:
        """The way in for this path, when the headers ask for nothing that needs a second look."""
        door = DOORS.get(path) or _other_door(path, headers)
        if door is None:
            return None
        declared, any_accept = not door.json_only, path.startswith("/v2/")  # which answers in bytes too
        authorization = None
        for name, value in headers:
            if name == b"content-type":
                declared = declared or value == b"application/json"
            elif name == b"authorization":
                authorization = value
            elif name == b"content-encoding" or (name == b"accept" and not any_accept and value not in _PLAIN_ACCEPT):
                return None
        return door if declared and self._admits(authorization) else None

    def _admits(self, authorization: bytes | None) -> bool:
        try:
            self._keys.admit(authorization, KeyScope.PREDICT)
        except CazslError:
            return False
        return True


def _other_door(path: str, headers: Headers) -> Door | None:
    """The way in for an upload, or for tensors: how their bodies are read, other headers say."""
    if path in UPLOADS:
        return Door(path, lambda content: read_upload(HeadersByName(raw=list(headers)), content), UPLOADS[path])
    asked = _INFER_PATH.fullmatch(path)
    if asked is None:
        return None
    model, version = asked["model"], asked["version"]
    length = next((value.decode("latin-1") for name, value in headers if name == LENGTH_HEADER.encode()), None)
    route = _INFER_ROUTES[version is not None]
    return Door(route, lambda content: InferRequest(model, version, length, content), infer, ask_inference)
