"""Worst requests for every field of every route: few faults, small answers, and nothing that stays in memory.

Here bodies are small enough to be many. ``python -m benchmarks.worst_requests`` sends the same kinds as large as the
limits allow, and measures time and memory.
"""

import asyncio
import gc
import json
import tracemalloc
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import pytest
from starlette.types import Message

from benchmarks.worst_bodies import MARK, WorstRequest, places, worst_requests
from benchmarks.worst_valid import valid_requests
from service.app import Service, create_app
from service.errors import InvalidRequestError
from service.inference.loaded_models import LoadedModels
from service.schemas import body
from service.settings import Settings
from tests.documented_api import document
from tests.running_service import shipped_models

SIZE = 70_000  # over documents.SHORT_BYTES
ANSWER_BYTES = 4096
MOST_FAULTS = 40
"""Faults that pydantic may collect: those of the rows of a visual context, or of ten unknown fields per object."""
KEPT_BYTES = 400_000
ALL = sorted({one.route for one in worst_requests(document(), 100)})


class Answers:
    """An app that is asked directly, and the number of faults that each body has."""

    def __init__(self, app: Service, monkeypatch: pytest.MonkeyPatch) -> None:
        self.app = app
        self.faults = 0
        described = body.invalid_request

        def count(found: Sequence[Mapping[str, Any]], prefix: tuple[str, ...] = ()) -> InvalidRequestError:
            """Count the faults that pydantic found, and describe them."""
            self.faults = len(found)
            return described(found, prefix)

        monkeypatch.setattr(body, "invalid_request", count)

    async def ask(self, request: WorstRequest) -> tuple[int, bytes]:
        """Send a request. Return status and body of the answer."""
        self.faults = 0
        content, sent = request.body(), list[Message]()

        async def receive() -> Message:
            """Return the body in one message."""
            return {"type": "http.request", "body": content, "more_body": False}

        async def send(message: Message) -> None:
            """Keep the messages of the answer."""
            sent.append(message)

        headers = {"Host": "localhost", "Content-Length": str(len(content))} | request.headers
        path, _, query = request.target.partition(b"?")
        scope: dict[str, Any] = {
            "type": "http",
            "http_version": "1.1",
            "method": request.method,
            "path": path.decode("latin-1"),
            "raw_path": path,
            "root_path": "",
            "scheme": "http",
            "query_string": query,
            "headers": [(name.lower().encode(), value.encode()) for name, value in headers.items()],
            "client": ("127.0.0.1", 1),
            "server": ("127.0.0.1", 8000),
        }
        await self.app(scope, receive, send)
        return int(sent[0]["status"]), b"".join(message.get("body", b"") for message in sent[1:])


@pytest.fixture(scope="module")
def models(tmp_path_factory: pytest.TempPathFactory) -> LoadedModels:
    """Return the shipped models."""
    return shipped_models(tmp_path_factory.mktemp("models"))


@pytest.fixture
def answers(models: LoadedModels, monkeypatch: pytest.MonkeyPatch) -> Answers:
    """Return the service over the shipped models, to be asked directly."""
    return Answers(create_app(Settings(poll_interval_s=3600, deadline_s=60), models), monkeypatch)


def check(request: WorstRequest, status: int, answer: bytes, faults: int) -> None:
    """Check the answer to one request."""
    assert status < 500, (request, answer)
    assert faults <= MOST_FAULTS, request
    if status == 200:
        return
    assert len(answer) <= ANSWER_BYTES, request
    assert 2 * MARK.encode() not in answer, request
    if answer.startswith(b'{"type"'):
        assert len(json.loads(answer)["errors"]) <= body.MAX_FAULTS, request


@pytest.mark.parametrize("route", ALL)
def test_the_worst_of_every_field_costs_few_faults_and_a_small_answer(route: str, answers: Answers) -> None:
    """Each worst value of each field, parameter and header is answered by a few KiB that repeat nothing."""

    async def scenario() -> Counter[int]:
        """Ask every worst request of the route."""
        found: Counter[int] = Counter()
        for request in worst_requests(document(), SIZE, route):
            status, answer = await answers.ask(request)
            check(request, status, answer, answers.faults)
            found[status] += 1
        return found

    found = asyncio.run(scenario())
    assert sum(found.values()) >= 10
    has_body = "requestBody" in str(document()["paths"][route])
    assert not has_body or sum(count for status, count in found.items() if status >= 400) > 50


def test_the_fields_of_every_body_are_found() -> None:
    """The walk over the schemas reaches every field, with those of lists and of forms that are not sent together."""
    media = document()["paths"]["/v1/predict/batch"]["post"]["requestBody"]["content"]["application/json"]
    found = {".".join(place) for place in places(document(), media["schema"])}
    contexts = {
        f"contexts.0.{name}"
        for name in ("descriptor", "indicator", "indicator.0", "visual.0.0", "image", "outline.0.0", "friction", MARK)
    }
    assert found >= contexts | {"model", "pushers.0.0", "context_index.0", "object_poses.0.0", "lengths.0", MARK}


def test_the_largest_valid_requests_are_answered(answers: Answers) -> None:
    """The largest request of each kind that the limits allow is answered with 200."""

    async def scenario() -> None:
        """Ask every valid request."""
        for request in valid_requests(size=1 << 20, pixels=(64, 48)):
            status, answer = await answers.ask(request)
            assert status == 200, (request, answer)

    asyncio.run(scenario())


def test_nothing_of_a_request_waits_for_the_garbage_collector(answers: Answers) -> None:
    """Bodies and documents are freed with their answers: a cycle of references would hold megabytes for minutes."""
    requests = [
        one
        for one in worst_requests(document(), 1 << 20, "/v1/predict/batch")
        if one.kind.startswith(("pushers:", "contexts.0.visual:"))
    ]
    requests += [one for one in valid_requests(1 << 20, (64, 48)) if "descriptors" in one.kind]

    async def scenario() -> None:
        """Ask each request, without the collector."""
        for request in requests[:1]:
            await answers.ask(request)
        gc.collect()
        gc.disable()
        tracemalloc.start()
        try:
            for request in requests:
                before, _ = tracemalloc.get_traced_memory()
                await answers.ask(request)
                for _ in range(1000):  # its thread may still be about to forget it
                    after, _ = tracemalloc.get_traced_memory()
                    if after - before < KEPT_BYTES:
                        break
                    await asyncio.sleep(0.005)
                assert after - before < KEPT_BYTES, request
        finally:
            tracemalloc.stop()
            gc.enable()

    asyncio.run(scenario())
