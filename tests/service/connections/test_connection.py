"""Connections join writes, bound heads, and answer plain pushes with the bytes of the framework, in any pieces.

tests/test_attacks.py tests the bounds on heads with raw sockets.
"""

import asyncio
import gc
import io
import json
import logging
import weakref
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from starlette.responses import PlainTextResponse
from starlette.types import Receive, Scope, Send

from service.api.v1.endpoints import SINGLE
from service.app import Service, create_app
from service.connections.framing import MAX_HEADERS, MAX_TARGET_BYTES
from service.connections.unsent import PairedWrites
from service.inference.loaded_models import LoadedModels
from service.inference.query import Answer, ContextBatch, Query, Warnings
from service.model.reference import ModelReference
from service.model.tensors import ContextKind, Gaussians
from service.observability.logs import RequestLog
from service.observability.metrics import RequestMetrics
from service.observability.telemetry import RequestTelemetry
from service.settings import Settings
from service.transport.admission import Admission, AdmissionLimits
from service.transport.callers import Callers
from service.transport.draining import CLOSE
from service.transport.endpoints import Endpoint, Endpoints, Weight
from service.transport.fast_path import Shortcut
from service.transport.keys import Keys
from service.transport.problems import problem_response
from service.transport.threads import ThreadPool
from tests.fake_connection import FakeConnection, FakeTransport, post, whole_answers
from tests.fakes import all_fake_models
from tests.request_strategies import ODD, PUSHER, pushes


def paired(transport: FakeTransport) -> PairedWrites:
    """Return the writes of a transport, which end at once."""
    writes = PairedWrites(transport, asyncio.get_running_loop(), lambda: writes.end())
    return writes


def sent_by(write: Callable[[PairedWrites], None]) -> list[bytes]:
    """Return the bytes of each system call for writes in one iteration."""

    async def run() -> list[bytes]:
        """Write in an event loop."""
        transport = FakeTransport()
        write(paired(transport))
        await asyncio.sleep(0)
        return transport.sent

    return asyncio.run(run())


@pytest.mark.parametrize(
    ("pieces", "calls"),
    [
        ((b"head", b"body"), [b"headbody"]),
        ((b"head",), [b"head"]),
        ((b"head", b""), [b"head"]),
        ((b"head", b"body", b"head", b"body"), [b"headbody", b"headbody"]),
        ((b"head", b"part", b"part"), [b"headpart", b"part"]),
        ((b"", b"body"), [b"body"]),
    ],
    ids=["an answer", "a head alone", "an empty body", "two answers", "a body in parts", "an empty head"],
)
def test_writes_of_an_iteration_are_sent_in_pairs(pieces: tuple[bytes, ...], calls: list[bytes]) -> None:
    """Head and body are sent in one call, and no bytes are held beyond the iteration."""

    def write(transport: PairedWrites) -> None:
        for piece in pieces:
            transport.write(piece)

    assert sent_by(write) == calls


def test_closing_sends_the_held_bytes() -> None:
    """A refusal that is written just before the connection closes is sent first."""

    def write(transport: PairedWrites) -> None:
        transport.write(b"refused")
        transport.close()
        assert transport.is_closing()

    assert sent_by(write) == [b"refused"]


def test_held_bytes_are_dropped_if_the_peer_is_gone() -> None:
    """Bytes that are held when the connection is lost are not sent."""
    transport = FakeTransport()

    async def run() -> None:
        """Write, then lose the connection."""
        paired(transport).write(b"head")
        transport.close()
        await asyncio.sleep(0)

    asyncio.run(run())
    assert transport.sent == []


def test_other_attributes_are_those_of_the_transport() -> None:
    """The address of the peer, which uvicorn reads, is that of the wrapped transport."""

    async def run() -> object:
        """Read the address in an event loop."""
        return paired(FakeTransport()).get_extra_info("peername")

    assert asyncio.run(run()) == ("192.0.2.1", 5)


@pytest.mark.parametrize("sent", [b"", b"POST /v1/predict HTTP/1.1\r\n"], ids=["silent", "in the middle of a head"])
def test_a_lost_connection_is_released_at_once(sent: bytes) -> None:
    """No timer holds a lost connection in memory, since a proxy may open thousands of short ones."""

    async def run() -> object:
        """Open a connection, send bytes and disconnect. Return the connection if it still exists."""
        connection = FakeConnection(PlainTextResponse("fine"), None)
        connection.receive(sent)
        connection.disconnect()
        left = weakref.ref(connection.protocol)
        del connection
        gc.collect()
        return left()

    assert asyncio.run(run()) is None


async def echo(scope: Scope, receive: Receive, send: Send) -> None:
    """Answer with the body, which is read message by message."""
    content, more = b"", True
    while more:
        message = await receive()
        assert type(message["body"]) is bytes
        content, more = content + message["body"], message["more_body"]
    length = (b"content-length", b"%d" % len(content))
    await send({"type": "http.response.start", "status": 200, "headers": [length]})
    await send({"type": "http.response.body", "body": content})


@pytest.mark.parametrize(
    "sizes",
    [(9,), (70_000,), (70_000, 70_000), (70_000, 1, 2, 70_000), (1,) * 9, (0, 5), (20_000, 20_000, 90_000)],
    ids=str,
)
@pytest.mark.parametrize("at_once", [True, False], ids=["in one iteration", "in several iterations"])
def test_a_body_arrives_complete_in_any_pieces(sizes: tuple[int, ...], at_once: bool) -> None:
    """A body reaches the application unchanged, in pieces of any sizes."""
    pieces = [bytes([65 + number]) * size for number, size in enumerate(sizes)]
    whole = b"".join(pieces)

    async def run() -> bytes:
        """Send the body piece by piece."""
        connection = FakeConnection(echo, None)
        connection.receive(f"POST / HTTP/1.1\r\nHost: h\r\nContent-Length: {len(whole)}\r\n\r\n".encode())
        for piece in pieces:
            connection.receive(piece)
            if not at_once:
                await asyncio.sleep(0)
                await asyncio.sleep(0)
        return await connection.answers(1)

    assert asyncio.run(run()).partition(b"\r\n\r\n")[2] == whole


def test_many_chunks_leave_turns_to_others() -> None:
    """Tiny chunks, which cost the most, are read some at a time, and the body is complete."""

    async def run() -> tuple[bytes, int]:
        """Send a read of the socket full of chunks. Count the turns of others until the answer."""
        connection = FakeConnection(echo, None)
        connection.receive(b"POST / HTTP/1.1\r\nHost: h\r\nTransfer-Encoding: chunked\r\n\r\n")
        connection.receive(b"4\r\nabcd\r\n" * 20_000 + b"0\r\n\r\n")
        turns = 0
        while not connection.transport.sent:
            await asyncio.sleep(0)
            turns += 1
        return await connection.answers(1), turns

    answer, turns = asyncio.run(run())
    assert answer.partition(b"\r\n\r\n")[2] == b"abcd" * 20_000
    assert turns > 20


def test_the_application_learns_of_a_refusal_within_its_body() -> None:
    """It answers no second time: the connection sends no more."""
    read: list[str] = []

    async def app(scope: Scope, receive: Receive, send: Send) -> None:
        """Read to the end, and answer whatever comes."""
        while not read or read[-1] == "http.request":
            read.append((await receive())["type"])
        await PlainTextResponse("late", 408)(scope, receive, send)

    async def run() -> bytes:
        """Send a chunk, then one that is none."""
        connection = FakeConnection(app, None)
        connection.receive(b"POST / HTTP/1.1\r\nHost: h\r\nTransfer-Encoding: chunked\r\n\r\n5\r\nabcde\r\n")
        for _ in range(9):
            await asyncio.sleep(0)
        connection.receive(b"zz\r\n")
        for _ in range(9):
            await asyncio.sleep(0)
        return b"".join(connection.transport.sent)

    answer = asyncio.run(run())
    assert read == ["http.request", "http.disconnect"]
    assert answer.startswith(b"HTTP/1.1 400 ")
    assert b"late" not in answer


FRAMEWORK = PlainTextResponse("the framework", 418)
SAME = "x-request-id: the-same"
PLAIN = ("content-type: application/json", SAME)
UNUSUAL_TYPE = ("content-type: application/json; charset=utf-8", SAME)  # means the same, and is unusual
BODY = json.dumps({"pusher": PUSHER}).encode()
FAILING_BODY = json.dumps({"pusher": PUSHER, "model": "push-failing"}).encode()
alike = settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None, max_examples=200)


@pytest.fixture(scope="module")
def models(tmp_path_factory: pytest.TempPathFactory) -> LoadedModels:
    """Return fake models of every kind, and one that fails."""
    return all_fake_models(tmp_path_factory.mktemp("models"))[1]


@pytest.fixture(scope="module")
def loop() -> Iterator[asyncio.Runner]:
    """Return one event loop for the application and its connections."""
    with asyncio.Runner() as runner:
        yield runner


@pytest.fixture(scope="module")
def app(models: LoadedModels) -> Service:
    """Return the whole application."""
    return create_app(Settings(poll_interval_s=3600), models, log=RequestLog(io.StringIO()))


def connect_to(app: Service) -> FakeConnection:
    """Open a connection as the service does."""
    return FakeConnection(app, app.shortcut)


class Buggy(Admission):
    """An admission with a bug."""

    def check(self, caller: str) -> None:
        """Raise an exception that is not of our tree."""
        raise ZeroDivisionError("the fake has a bug")


def shortcut_only(
    models: LoadedModels,
    in_flight: int = 8,
    keys: Path | None = None,
    admission: type[Admission] = Admission,
    endpoint: Endpoint[Any] = SINGLE,
) -> Shortcut:
    """Create a shortcut in front of a framework that answers every request with 418."""
    endpoints = Endpoints([endpoint], models, ThreadPool(1, 8, 10.0))
    admitted = admission(FRAMEWORK, AdmissionLimits(1 << 20, 10.0, in_flight, 0, 1 << 24), Callers(Keys(keys)))
    log = RequestLog(io.StringIO())
    telemetry = RequestTelemetry(admitted, problem_response, log, RequestMetrics(lambda *_: True))
    return Shortcut(endpoint, endpoints, admitted, telemetry)


def exchange(loop: asyncio.Runner, connect: Callable[[], FakeConnection], *pieces: bytes, answers: int = 1) -> bytes:
    """Send pieces on a new connection, one after the other. Return the answers."""

    async def run() -> bytes:
        """Send and receive in the event loop."""
        connection = connect()
        for piece in pieces:
            connection.receive(piece)
        return await connection.answers(answers)

    return loop.run(run())


def status(answer: bytes) -> int:
    """Return the status of the first answer."""
    return int(answer.split(b" ", 2)[1])


@alike
@given(pushes)
def test_a_push_gets_the_same_bytes_both_ways(loop: asyncio.Runner, app: Service, body: Any) -> None:
    """Shortcut and framework send the same head and body, for predictions and for refusals."""
    content = json.dumps(body).encode()
    short, long = (
        exchange(loop, lambda: connect_to(app), post("/v1/predict", content, kind)) for kind in (PLAIN, UNUSUAL_TYPE)
    )
    assert whole_answers(short) == [short]
    assert short == long


@pytest.mark.parametrize("name", ODD)
def test_odd_bodies_get_the_same_bytes_both_ways(loop: asyncio.Runner, app: Service, name: str) -> None:
    """Shortcut and framework agree on odd bodies too, also if the model fails at the end of the iteration."""
    short, long = (
        exchange(loop, lambda: connect_to(app), post("/v1/predict", ODD[name], kind)) for kind in (PLAIN, UNUSUAL_TYPE)
    )
    assert short == long


@alike
@given(st.lists(st.sampled_from([BODY, FAILING_BODY, b"{}"]), min_size=1, max_size=4), st.data())
def test_pipelined_requests_in_any_pieces_are_answered_in_order(
    loop: asyncio.Runner, app: Service, bodies: list[bytes], data: st.DataObject
) -> None:
    """A network may cut requests anywhere, and a client may send the next one before it has its answer."""
    sent = b"".join(post("/v1/predict", body, PLAIN) for body in bodies)
    cuts = sorted(data.draw(st.lists(st.integers(0, len(sent)), max_size=5)))
    pieces = [sent[start:end] for start, end in zip([0, *cuts], [*cuts, len(sent)], strict=True)]

    received = exchange(loop, lambda: connect_to(app), *pieces, answers=len(bodies))

    alone = [exchange(loop, lambda: connect_to(app), post("/v1/predict", body, PLAIN)) for body in bodies]
    assert whole_answers(received) == alone


def test_a_plain_push_needs_no_application(loop: asyncio.Runner, models: LoadedModels) -> None:
    """The connection itself answers plain pushes, one after the other."""

    async def run() -> bytes:
        """Send two pushes, and await each answer."""
        connection = FakeConnection(FRAMEWORK, shortcut_only(models))
        for answers in (1, 2):
            connection.receive(post("/v1/predict", BODY))
            await connection.answers(answers)
        return b"".join(connection.transport.sent)

    assert [status(answer) for answer in whole_answers(loop.run(run()))] == [200, 200]


@pytest.mark.parametrize("body", [BODY, b"{}"], ids=["good", "refused"])
def test_each_of_many_requests_in_one_write_has_an_iteration(
    loop: asyncio.Runner, models: LoadedModels, body: bytes
) -> None:
    """A client that sends many requests at once does not hold the event loop: each is answered in its own iteration."""

    async def run() -> list[int]:
        """Send requests in one write. Return the numbers of answers after each iteration."""
        connection = FakeConnection(FRAMEWORK, shortcut_only(models))
        connection.receive(post("/v1/predict", body) * 5)
        counts: list[int] = []
        while not counts or counts[-1] < 5:
            await asyncio.sleep(0)
            counts.append(len(whole_answers(b"".join(connection.transport.sent))))
        return counts

    counts = loop.run(run())
    assert all(after - before <= 1 for before, after in zip([0, *counts], counts, strict=False))


def test_many_pipelined_refusals_are_not_taken_for_one_long_head(loop: asyncio.Runner, app: Service) -> None:
    """More than 64 KiB of refused requests in one write get an answer each, and none gets a 431."""
    sent = post("/v1/predict", b"{}", PLAIN) * 700
    received = exchange(loop, lambda: connect_to(app), sent, answers=700)
    assert {status(answer) for answer in whole_answers(received)} == {422}
    assert len(whole_answers(received)) == 700


def test_a_connection_is_not_idle_while_a_pipelined_request_is_incomplete(loop: asyncio.Runner, app: Service) -> None:
    """The first answer must not begin the idle time under the second request."""

    async def run() -> tuple[bool, bool]:
        """Send a push and a part of the next one in one write, then the other part."""
        connection = connect_to(app)
        request = post("/v1/predict", BODY, PLAIN)
        connection.receive(request + request[:-5])
        await connection.answers(1)
        between = connection.protocol.is_idle()
        connection.receive(request[-5:])
        await connection.answers(2)
        return between, connection.protocol.is_idle()

    assert loop.run(run()) == (False, True)


TYPE = "content-type: application/json"
CHUNKED = b"POST /v1/predict HTTP/1.1\r\nhost: test\r\n%b\r\ntransfer-encoding: chunked\r\n\r\n%x\r\n%b\r\n0\r\n\r\n"
UNUSUAL = {
    "another path": post("/v1/predict/batch", BODY),
    "a query": post("/v1/predict?x=1", BODY),
    "another method": b"PUT" + post("/v1/predict", BODY)[4:],
    "another type": post("/v1/predict", BODY, UNUSUAL_TYPE),
    "another accept": post("/v1/predict", BODY, (TYPE, "accept: text/html")),
    "compressed": post("/v1/predict", BODY, (TYPE, "content-encoding: gzip")),
    "a client that leaves": post("/v1/predict", BODY, (TYPE, "connection: close")),
    "an older client": post("/v1/predict", BODY).replace(b"HTTP/1.1", b"HTTP/1.0"),
    "a client that expects 100": post("/v1/predict", BODY, (TYPE, "expect: 100-continue")),
    "chunks": CHUNKED % (TYPE.encode(), len(BODY), BODY),
    "no body": post("/v1/predict", b""),
    "a large body": post("/v1/predict", BODY + b" " * 4096),  # hundreds may be answered in one iteration
    "an image": post("/v1/predict", b'{"pusher": {"x": 0, "y": 0, "angle": 0}, "context": {"image": "AAAA"}}'),
    "an outline that is new": post(
        "/v1/predict",
        b'{"pusher": {"x": -1, "y": 0, "angle": 0}, "context": {"outline": [[0, 0], [0.0712, 0], [0, 0.0534]]}}',
    ),
    "an escape, which may spell image": post("/v1/predict", BODY[:-1] + b', "context": {"\\u0069mage": "AAAA"}}'),
}
REFUSED = {
    "no pusher": (post("/v1/predict", b"{}"), 422),
    "not JSON": (post("/v1/predict", b"{"), 400),
    "an unknown model": (post("/v1/predict", BODY[:-1] + b', "model": "nobody"}'), 404),
    "a failing model": (post("/v1/predict", FAILING_BODY[:-1] + b', "context": {"descriptor": "1a2b3c4a"}}'), 500),
    "another kind of context": (post("/v1/predict", FAILING_BODY), 422),
}


@pytest.mark.parametrize(("headers", "target"), [(MAX_HEADERS, 100), (1, MAX_TARGET_BYTES)])
def test_a_head_at_its_limits_is_accepted_and_one_over_them_is_not(
    loop: asyncio.Runner, app: Service, headers: int, target: int
) -> None:
    """Many short headers and long targets cost far more than their bytes, so both have limits of their own."""
    more = b"a: b\r\n"
    for extra, expected in ((0, 404), (1, 431)):
        path = b"/" + b"a" * (target - 1 + extra * (headers == 1))
        lines = more * (headers - 1 + extra * (headers > 1))
        sent = b"GET %b HTTP/1.1\r\nhost: test\r\n%b\r\n" % (path, lines)
        assert status(exchange(loop, lambda: connect_to(app), sent)) == expected


@pytest.mark.parametrize("name", UNUSUAL)
def test_an_unusual_request_goes_to_the_framework(loop: asyncio.Runner, models: LoadedModels, name: str) -> None:
    """The shortcut answers plain requests for one push only."""
    received = exchange(loop, lambda: FakeConnection(FRAMEWORK, shortcut_only(models)), UNUSUAL[name])
    answer = received.removeprefix(b"HTTP/1.1 100 Continue\r\n\r\n")
    assert status(answer) == 418


@pytest.mark.parametrize("name", REFUSED)
def test_a_plain_push_that_is_refused_needs_no_framework(loop: asyncio.Runner, models: LoadedModels, name: str) -> None:
    """The shortcut answers a plain single push also if the answer is a problem."""
    sent, expected = REFUSED[name]
    assert status(exchange(loop, lambda: FakeConnection(FRAMEWORK, shortcut_only(models)), sent)) == expected


def test_a_full_service_refuses_single_pushes_too(loop: asyncio.Runner, models: LoadedModels) -> None:
    """The limit of concurrent requests holds for single pushes, though they never count as in flight."""
    received = exchange(
        loop, lambda: FakeConnection(FRAMEWORK, shortcut_only(models, in_flight=0)), post("/v1/predict", BODY)
    )
    assert status(received) == 503


def test_a_request_without_its_key_is_refused(loop: asyncio.Runner, models: LoadedModels, tmp_path: Path) -> None:
    """The shortcut checks the key at the head, and passes a refusal on before a byte of the body has come."""
    (tmp_path / "keys").write_text("")
    shortcut = shortcut_only(models, keys=tmp_path / "keys")
    head = post("/v1/predict", BODY)[: -len(BODY)]
    received = exchange(loop, lambda: FakeConnection(FRAMEWORK, shortcut), head)
    assert status(received) == 418


def test_a_bug_of_the_shortcut_is_logged_and_answered_with_a_500(
    loop: asyncio.Runner, models: LoadedModels, caplog: pytest.LogCaptureFixture
) -> None:
    """The client gets a problem, and the log gets the exception with the request id."""
    received = exchange(
        loop, lambda: FakeConnection(FRAMEWORK, shortcut_only(models, admission=Buggy)), post("/v1/predict", BODY)
    )
    assert status(received) == 500
    assert b"ZeroDivisionError" not in received
    assert "the fake has a bug" in caplog.text


@dataclass(frozen=True, slots=True)
class Unencodable(Query):
    """A query whose answer cannot be encoded."""

    def encode(self, found: Gaussians, warnings: Warnings) -> Answer:
        """Raise an exception that is not of our tree."""
        raise ZeroDivisionError("the fake has a bug")


def test_an_answer_that_cannot_be_encoded_is_a_500(
    loop: asyncio.Runner, models: LoadedModels, caplog: pytest.LogCaptureFixture
) -> None:
    """A bug in the encoding of an answer must not leave the client waiting."""
    model = models.snapshot.find(ModelReference.parse("push-none"))
    contexts = ContextBatch(ContextKind.NONE, (), None, "body.context")
    query = Unencodable(model, np.zeros((1, 3), dtype=np.float32), contexts, ())
    shortcut = shortcut_only(models, endpoint=replace(SINGLE, ask=lambda *_: query))
    received = exchange(loop, lambda: FakeConnection(FRAMEWORK, shortcut), post("/v1/predict", BODY))
    assert status(received) == 500
    assert "the fake has a bug" in caplog.text


def test_a_push_that_turns_out_to_be_heavy_goes_to_the_framework(loop: asyncio.Runner, models: LoadedModels) -> None:
    """The shortcut passes on a request that needs a thread, even if its body looked plain."""
    shortcut = shortcut_only(models, endpoint=replace(SINGLE, weigh=lambda _: Weight.HEAVY))
    received = exchange(loop, lambda: FakeConnection(FRAMEWORK, shortcut), post("/v1/predict", BODY))
    assert status(received) == 418


def test_a_late_body_costs_one_limit(loop: asyncio.Runner, models: LoadedModels) -> None:
    """The shortcut refuses a late body itself, and closes only its sending half: the client reads the answer."""

    async def run() -> tuple[bytes, bool, bool]:
        """Send a part of a request, and no more."""
        connection = FakeConnection(FRAMEWORK, shortcut_only(models), head_s=0.2)
        connection.receive(post("/v1/predict", BODY)[:-5])
        answer = await connection.answers(1)
        return answer, connection.transport.ended, connection.transport.closed

    answer, ended, closed = loop.run(run())
    assert status(answer) == 408
    assert b"slow_body" in answer
    assert (ended, closed) == (True, False)


def test_a_client_that_leaves_in_the_middle_is_logged(
    loop: asyncio.Runner, models: LoadedModels, caplog: pytest.LogCaptureFixture
) -> None:
    """The log line of a client that left before its answer has status 0."""
    caplog.set_level(logging.INFO, "service.requests")
    stream = io.StringIO()
    log = RequestLog(stream)
    app = create_app(Settings(), models, log=log)

    async def run() -> None:
        """Send a part of a request, and disconnect."""
        connection = connect_to(app)
        connection.receive(post("/v1/predict", BODY, PLAIN)[:-5])
        connection.disconnect()
        await asyncio.gather(*connection.state.tasks)

    loop.run(run())
    log.flush()
    assert [json.loads(line)["status"] for line in stream.getvalue().splitlines()] == [0]


def test_a_client_that_leaves_before_its_answer_does_not_affect_others(loop: asyncio.Runner, app: Service) -> None:
    """If clients of an iteration leave before it ends, the other clients still get their answers."""

    async def run() -> list[bytes]:
        """Send three pushes in one iteration. Two clients leave before it ends."""
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


@pytest.mark.parametrize("cut", [0, 5], ids=["complete", "incomplete"])
def test_a_request_that_has_begun_at_shutdown_is_answered(loop: asyncio.Runner, app: Service, cut: int) -> None:
    """At shutdown a request on a connection is answered, and an incomplete one closes its connection."""

    async def run() -> bytes:
        """Shut down in the middle of a request, or between it and its answer."""
        connection = connect_to(app)
        sent = post("/v1/predict", BODY, PLAIN)
        connection.receive(sent[: len(sent) - cut])
        connection.protocol.shutdown()
        connection.receive(sent[len(sent) - cut :])
        return await connection.answers(1)

    received = loop.run(run())
    assert status(received) == 200
    assert (b"connection: close" in received) is (cut > 0)


def test_a_draining_service_closes_the_connection_with_its_answer(loop: asyncio.Runner, app: Service) -> None:
    """While the service drains, the framework answers and closes the connection."""

    async def run() -> tuple[bytes, bool]:
        """Send a push while the service drains."""
        connection = connect_to(app)
        connection.state.default_headers = [CLOSE]
        connection.receive(post("/v1/predict", BODY, PLAIN))
        return await connection.answers(1), connection.transport.closed

    received, closed = loop.run(run())
    assert b"connection: close" in received
    assert closed


@pytest.mark.parametrize("kind", [PLAIN, UNUSUAL_TYPE], ids=["shortcut", "ring"])
@pytest.mark.parametrize("cut", [0, 5], ids=["complete", "incomplete"])
def test_an_answer_that_asks_to_leave_is_the_last_one(
    loop: asyncio.Runner, app: Service, kind: tuple[str, ...], cut: int
) -> None:
    """A request may have begun before the service began to drain."""

    async def run() -> tuple[bytes, bool]:
        """Begin to drain in the middle of a request, or before its answer."""
        connection = connect_to(app)
        sent = post("/v1/predict", BODY, kind)
        connection.receive(sent[: len(sent) - cut])
        connection.state.default_headers = [CLOSE]
        connection.receive(sent[len(sent) - cut :] + sent)
        return await connection.answers(2), connection.transport.closed or connection.transport.ended

    received, closed = loop.run(run())
    assert len(whole_answers(received)) == 1
    assert b"connection: close" in received
    assert closed


@pytest.mark.parametrize("kind", [PLAIN, UNUSUAL_TYPE], ids=["shortcut", "ring"])
def test_signal_while_an_answer_is_written_leaves_its_connection_open(
    loop: asyncio.Runner, app: Service, kind: tuple[str, ...]
) -> None:
    """A client that was not asked to leave gets its next answer, also if the service began to drain meanwhile."""

    async def run() -> tuple[bytes, bool]:
        """Begin to drain in the system call that writes an answer."""
        connection = connect_to(app)
        write = connection.transport.write

        def write_during_signal(data: bytes | bytearray | memoryview) -> None:
            """Write, and add the header as the handler of SIGTERM does."""
            write(data)
            connection.state.default_headers = [CLOSE]

        connection.transport.write = write_during_signal  # type: ignore[method-assign]
        connection.receive(post("/v1/predict", BODY, kind))
        return await connection.answers(1), connection.transport.closed

    received, closed = loop.run(run())
    assert b"connection: close" not in received
    assert not closed
