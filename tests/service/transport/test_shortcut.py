"""The shortcut gives the bytes of the framework, however a request arrives, and leaves unusual heads to it."""

import asyncio
import io
import json
import logging
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from starlette.responses import PlainTextResponse

from service.api.v1.endpoints import SINGLE
from service.app import Service, create_app
from service.inference.loaded_models import LoadedModels
from service.observability.logs import RequestLog
from service.observability.metrics import RequestMetrics
from service.observability.telemetry import RequestTelemetry
from service.settings import Settings
from service.transport.admission import Admission, AdmissionLimits
from service.transport.connection import CLOSE
from service.transport.endpoints import LIGHT_BYTES, Endpoints
from service.transport.fast_path import Shortcut
from service.transport.keys import Keys
from service.transport.threads import ThreadPool
from tests.fake_connection import FakeConnection, post, whole_answers
from tests.fakes import all_fake_models
from tests.request_strategies import ODD, PUSHER, pushes

FRAMEWORK = PlainTextResponse("the framework", 418)
SAME = "x-request-id: the-same"
PLAIN = ("content-type: application/json", SAME)
LONG = ("content-type: application/json; charset=utf-8", SAME)  # means the same, and is unusual
BODY = json.dumps({"pusher": PUSHER}).encode()
FAILING_BODY = json.dumps({"pusher": PUSHER, "model": "push-failing"}).encode()
alike = settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None, max_examples=200)


@pytest.fixture(scope="module")
def models(tmp_path_factory: pytest.TempPathFactory) -> LoadedModels:
    """Fakes of every kind, and one that fails."""
    return all_fake_models(tmp_path_factory.mktemp("models"))[1]


@pytest.fixture(scope="module")
def loop() -> Iterator[asyncio.Runner]:
    """One event loop for the app and all that is asked of it."""
    with asyncio.Runner() as runner:
        yield runner


@pytest.fixture(scope="module")
def app(models: LoadedModels) -> Service:
    """The whole app."""
    return create_app(Settings(poll_interval_s=3600), models, log=RequestLog(io.StringIO()))


def connect_to(app: Service) -> FakeConnection:
    """A connection as the service makes them."""
    return FakeConnection(app, app.shortcut)


class Buggy(Admission):
    """An admission with a bug."""

    def check(self, scope: Any) -> None:
        """Raise an exception that is not of our tree."""
        raise ZeroDivisionError("the fake has a bug")


def shortcut_only(
    models: LoadedModels, in_flight: int = 8, keys: Path | None = None, admission: type[Admission] = Admission
) -> Shortcut:
    """A shortcut whose framework answers every request with 418."""
    endpoints = Endpoints([SINGLE], models, ThreadPool(1, 8, 10.0), Keys(keys))
    admitted = admission(FRAMEWORK, AdmissionLimits(1 << 20, 10.0, in_flight, 0, 1 << 24))
    log = RequestLog(io.StringIO())
    telemetry = RequestTelemetry(admitted, FRAMEWORK, log, RequestMetrics(lambda *_: True))
    return Shortcut(SINGLE, endpoints, admitted, telemetry)


def asked(loop: asyncio.Runner, connect: Callable[[], FakeConnection], *pieces: bytes, answers: int = 1) -> bytes:
    """What is answered to pieces that come one after the other."""

    async def run() -> bytes:
        """On a connection of its own."""
        connection = connect()
        for piece in pieces:
            connection.receive(piece)
        return await connection.answers(answers)

    return loop.run(run())


def status(answer: bytes) -> int:
    """Of the first answer."""
    return int(answer.split(b" ", 2)[1])


@alike
@given(pushes)
def test_a_push_gets_the_same_bytes_both_ways(loop: asyncio.Runner, app: Service, body: Any) -> None:
    """The whole answer as it leaves, head and body, of answers and refusals alike."""
    content = json.dumps(body).encode()
    short, long = (asked(loop, lambda: connect_to(app), post("/v1/predict", content, kind)) for kind in (PLAIN, LONG))
    assert whole_answers(short) == [short]
    assert short == long


@pytest.mark.parametrize("name", ODD)
def test_odd_bodies_get_the_same_bytes_both_ways(loop: asyncio.Runner, app: Service, name: str) -> None:
    """A model that fails among them, which shows at the end of the turn only."""
    short, long = (asked(loop, lambda: connect_to(app), post("/v1/predict", ODD[name], kind)) for kind in (PLAIN, LONG))
    assert short == long


@alike
@given(st.lists(st.sampled_from([BODY, FAILING_BODY, b"{}"]), min_size=1, max_size=4), st.data())
def test_however_requests_are_cut_and_crowded_each_gets_its_answer_in_order(
    loop: asyncio.Runner, app: Service, bodies: list[bytes], data: st.DataObject
) -> None:
    """A network may cut anywhere, and a client need not wait for an answer before it asks again."""
    said = b"".join(post("/v1/predict", body, PLAIN) for body in bodies)
    cuts = sorted(data.draw(st.lists(st.integers(0, len(said)), max_size=5)))
    pieces = [said[start:end] for start, end in zip([0, *cuts], [*cuts, len(said)], strict=True)]

    heard = asked(loop, lambda: connect_to(app), *pieces, answers=len(bodies))

    alone = [asked(loop, lambda: connect_to(app), post("/v1/predict", body, PLAIN)) for body in bodies]
    assert whole_answers(heard) == alone


def test_a_plain_push_needs_no_application(loop: asyncio.Runner, models: LoadedModels) -> None:
    """It is answered on its connection, one time after the other."""

    async def run() -> bytes:
        """Ask twice, waiting for the answer."""
        connection = FakeConnection(FRAMEWORK, shortcut_only(models))
        for answers in (1, 2):
            connection.receive(post("/v1/predict", BODY))
            await connection.answers(answers)
        return b"".join(connection.transport.sent)

    assert [status(answer) for answer in whole_answers(loop.run(run()))] == [200, 200]


def test_a_client_that_does_not_await_answers_loses_the_shortcut(loop: asyncio.Runner, models: LoadedModels) -> None:
    """It could hold the loop with all that it sends in one go."""
    said = post("/v1/predict", BODY) * 3
    heard = asked(loop, lambda: FakeConnection(FRAMEWORK, shortcut_only(models)), said, answers=3)
    assert [status(answer) for answer in whole_answers(heard)] == [200, 418, 418]


TYPE = "content-type: application/json"
CHUNKED = b"POST /v1/predict HTTP/1.1\r\nhost: test\r\n%b\r\ntransfer-encoding: chunked\r\n\r\n%x\r\n%b\r\n0\r\n\r\n"
UNUSUAL = {
    "another path": post("/v1/predict/batch", BODY),
    "a query": post("/v1/predict?x=1", BODY),
    "another method": b"PUT" + post("/v1/predict", BODY)[4:],
    "another type": post("/v1/predict", BODY, LONG),
    "another accept": post("/v1/predict", BODY, (TYPE, "accept: text/html")),
    "compressed": post("/v1/predict", BODY, (TYPE, "content-encoding: gzip")),
    "a client that leaves": post("/v1/predict", BODY, (TYPE, "connection: close")),
    "an older client": post("/v1/predict", BODY).replace(b"HTTP/1.1", b"HTTP/1.0"),
    "an upgrade": post("/v1/predict", BODY, (TYPE, "connection: upgrade", "upgrade: h2c")),
    "a client that asks first": post("/v1/predict", BODY, (TYPE, "expect: 100-continue")),
    "chunks": CHUNKED % (TYPE.encode(), len(BODY), BODY),
    "nothing": post("/v1/predict", b""),
    "much": post("/v1/predict", BODY + b" " * LIGHT_BYTES),
    "an image": post("/v1/predict", b'{"pusher": {"x": 0, "y": 0, "angle": 0}, "context": {"image": "AAAA"}}'),
}
REFUSED = {
    "a fault": (post("/v1/predict", b"{}"), 422),
    "no JSON": (post("/v1/predict", b"{"), 400),
    "an unknown model": (post("/v1/predict", BODY[:-1] + b', "model": "nobody"}'), 404),
    "a failing model": (post("/v1/predict", FAILING_BODY[:-1] + b', "context": {"descriptor": "1a2b3c4a"}}'), 500),
    "another kind of context": (post("/v1/predict", FAILING_BODY), 422),
}


@pytest.mark.parametrize("name", UNUSUAL)
def test_an_unusual_request_goes_to_the_framework(loop: asyncio.Runner, models: LoadedModels, name: str) -> None:
    """Only a plain request for one push is answered by the shortcut."""
    heard = asked(loop, lambda: FakeConnection(FRAMEWORK, shortcut_only(models)), UNUSUAL[name])
    answer = heard.removeprefix(b"HTTP/1.1 100 Continue\r\n\r\n")
    assert status(answer) == 418


@pytest.mark.parametrize("name", REFUSED)
def test_a_plain_push_that_is_refused_needs_no_framework(loop: asyncio.Runner, models: LoadedModels, name: str) -> None:
    """A plain single push is read once, also where the answer is a problem."""
    said, expected = REFUSED[name]
    assert status(asked(loop, lambda: FakeConnection(FRAMEWORK, shortcut_only(models)), said)) == expected


def test_a_full_service_refuses_single_pushes_too(loop: asyncio.Runner, models: LoadedModels) -> None:
    """The limit of requests in flight holds for requests that would never count as in flight."""
    heard = asked(
        loop, lambda: FakeConnection(FRAMEWORK, shortcut_only(models, in_flight=0)), post("/v1/predict", BODY)
    )
    assert status(heard) == 503


def test_a_request_without_its_key_is_refused(loop: asyncio.Runner, models: LoadedModels, tmp_path: Path) -> None:
    """The shortcut checks the key once, and names the missing header."""
    (tmp_path / "keys").write_text("")
    shortcut = shortcut_only(models, keys=tmp_path / "keys")
    heard = asked(loop, lambda: FakeConnection(FRAMEWORK, shortcut), post("/v1/predict", BODY))
    assert status(heard) == 401
    assert b"header Authorization" in heard


def test_a_bug_of_the_shortcut_is_logged_and_answered_with_a_500(
    loop: asyncio.Runner, models: LoadedModels, caplog: pytest.LogCaptureFixture
) -> None:
    """The client gets a problem, and the log the exception under its request id."""
    heard = asked(
        loop, lambda: FakeConnection(FRAMEWORK, shortcut_only(models, admission=Buggy)), post("/v1/predict", BODY)
    )
    assert status(heard) == 500
    assert b"ZeroDivisionError" not in heard
    assert "the fake has a bug" in caplog.text


def test_a_request_that_is_late_is_handed_over_to_be_refused(loop: asyncio.Runner, models: LoadedModels) -> None:
    """The long way has a clock for bodies."""

    async def run() -> bytes:
        """Say a half, and nothing more."""
        connection = FakeConnection(FRAMEWORK, shortcut_only(models), head_s=0.0)
        connection.receive(post("/v1/predict", BODY)[:-5])
        return await connection.answers(1)

    assert status(loop.run(run())) == 418


def test_a_client_that_leaves_in_the_middle_is_logged(
    loop: asyncio.Runner, models: LoadedModels, caplog: pytest.LogCaptureFixture
) -> None:
    """As on the long way: its status is 0."""
    caplog.set_level(logging.INFO, "service.requests")
    stream = io.StringIO()
    log = RequestLog(stream)
    app = create_app(Settings(), models, log=log)

    async def run() -> None:
        """Say a half, and be gone."""
        connection = connect_to(app)
        connection.receive(post("/v1/predict", BODY, PLAIN)[:-5])
        connection.disconnect()
        await asyncio.gather(*connection.state.tasks)

    loop.run(run())
    log.flush()
    assert [json.loads(line)["status"] for line in stream.getvalue().splitlines()] == [0]


def test_a_client_that_leaves_before_its_answer_disturbs_nobody(loop: asyncio.Runner, app: Service) -> None:
    """Whether the model answers or fails, the others of the turn get theirs."""

    async def run() -> list[bytes]:
        """Three in one turn, two of which are gone at its end."""
        connections = [connect_to(app) for _ in range(3)]
        for connection, body in zip(connections, (BODY, FAILING_BODY, BODY), strict=True):
            connection.receive(post("/v1/predict", body, PLAIN))
        for connection in connections[:2]:
            connection.disconnect()
        await connections[2].answers(1)
        return [b"".join(connection.transport.sent) for connection in connections]

    *gone, stayed = loop.run(run())
    assert gone == [b"", b""]
    assert status(stayed) == 200


@pytest.mark.parametrize("cut", [0, 5], ids=["whole", "half"])
def test_what_has_come_when_the_doors_close_is_answered(loop: asyncio.Runner, app: Service, cut: int) -> None:
    """As the last on its connection, where the client can still be told so."""

    async def run() -> bytes:
        """Close in the middle of a request, or between it and its answer."""
        connection = connect_to(app)
        said = post("/v1/predict", BODY, PLAIN)
        connection.receive(said[: len(said) - cut])
        connection.protocol.shutdown()
        connection.receive(said[len(said) - cut :])
        return await connection.answers(1)

    heard = loop.run(run())
    assert status(heard) == 200
    assert (b"connection: close" in heard) is (cut > 0)


def test_a_service_that_is_to_end_says_so_with_every_answer(loop: asyncio.Runner, app: Service) -> None:
    """The long way closes the connection after it."""

    async def run() -> tuple[bytes, bool]:
        """Ask while it drains."""
        connection = connect_to(app)
        connection.state.default_headers = [CLOSE]
        connection.receive(post("/v1/predict", BODY, PLAIN))
        return await connection.answers(1), connection.transport.closed

    heard, closed = loop.run(run())
    assert b"connection: close" in heard
    assert closed


def test_with_a_ring_around_all_requests_there_is_no_shortcut(models: LoadedModels) -> None:
    """Spans would miss those that take it."""

    def ring(app: Any) -> Any:
        """Another app."""
        return lambda *asgi: app(*asgi)

    assert create_app(Settings(), models, trace=ring).shortcut is None
