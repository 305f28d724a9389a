"""Requests in every form that HTTP has, by every way in: shortcut, fast path, thread and framework.

A form that is allowed gets the answer of the plain one, and another is refused with one status. The ways agree.
"""

import asyncio
import io
import json
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from service.app import Service, create_app
from service.connections.framing import MAX_HEADERS
from service.inference.loaded_models import LoadedModels
from service.observability.logs import RequestLog
from service.settings import Settings
from service.transport.endpoints import LIGHT_PUSHES
from service.transport.keys import Grant, Scope
from tests.fake_connection import FakeConnection, whole_answers
from tests.fakes import all_fake_models

PUSHER = [-0.075, 0.0, 0.0]
SINGLE = json.dumps({"pusher": {"x": -0.075, "y": 0.0, "angle": 0.0}}).encode()
BATCH = json.dumps({"pushers": [PUSHER] * (LIGHT_PUSHES + 1), "model": "push-none"}).encode()
Head = tuple[bytes, list[bytes]]  # request line, headers
JSON = b"content-type: application/json"
WAYS: dict[str, tuple[bytes, list[bytes], bytes]] = {
    "shortcut": (b"POST /v1/predict HTTP/1.1", [JSON], SINGLE),
    "fast path": (b"POST /v1/predict HTTP/1.1", [JSON + b"; charset=utf-8"], SINGLE),
    "thread": (b"POST /v1/predict/batch HTTP/1.1", [JSON], BATCH),
    "framework": (b"GET /v1/models HTTP/1.1", [JSON], b"{}"),
}
ALWAYS = [b"host: test", b"x-request-id: the-same", b"accept: */*"]
Form = Callable[[bytes, list[bytes], bytes], bytes]


def request(line: bytes, headers: list[bytes], body: bytes) -> bytes:
    """Return a plain request."""
    return b"\r\n".join((line, *headers, b"content-length: %d" % len(body), b"", b"")) + body


def with_headers(*more: bytes) -> Form:
    """Return a form with more headers."""
    return lambda line, headers, body: request(line, [*headers, *more], body)


def without(*names: bytes) -> Form:
    """Return a form without these headers."""
    return lambda line, headers, body: request(line, [one for one in headers if not one.startswith(names)], body)


def replaced(old: bytes, new: bytes) -> Form:
    """Return a form in which bytes of the plain one are replaced once."""

    def form(line: bytes, headers: list[bytes], body: bytes) -> bytes:
        plain = request(line, headers, body)
        assert old in plain
        return plain.replace(old, new, 1)

    return form


def chunked(*more: bytes, size: bytes = b"%x", trailers: bytes = b"", last: bytes = b"0", step: int = 7) -> Form:
    """Return a form whose body is sent in chunks."""

    def form(line: bytes, headers: list[bytes], body: bytes) -> bytes:
        width = max(step, len(body) // 20)
        parts = [body[at : at + width] for at in range(0, len(body), width)]
        chunks = b"".join(size % len(part) + b"\r\n" + part + b"\r\n" for part in parts)
        head = b"\r\n".join((line, *headers, b"transfer-encoding: chunked", *more, b"", b""))
        return head + chunks + last + b"\r\n" + trailers + b"\r\n"

    return form


ALLOWED: dict[str, Form] = {
    "chunks": chunked(),
    "chunks with extensions": chunked(size=b'%x;name="a value";other'),
    "chunks with zeros": chunked(size=b"0000%X"),
    "chunks with trailers": chunked(trailers=b"x-sum: 1\r\nauthorization: Bearer x\r\n"),
    "trailers that would refuse": chunked(trailers=b"content-type: text/plain\r\naccept: text/html\r\nhost: b\r\n"),
    "trailers of the connection": chunked(
        trailers=b"connection: close\r\ncontent-length: 5\r\ntransfer-encoding: gzip\r\nupgrade: h2c\r\n"
    ),
    "an extension of the last chunk": chunked(last=b"0;a=b"),
    "an offer of h2c": with_headers(
        b"connection: Upgrade, HTTP2-Settings", b"upgrade: h2c", b"http2-settings: AAEAAEAA"
    ),
    "an offer of h2c and chunks": chunked(b"connection: upgrade", b"upgrade: h2c"),
    "an offer of a websocket": with_headers(
        b"connection: Upgrade", b"upgrade: websocket", b"sec-websocket-key: x", b"sec-websocket-version: 13"
    ),
    "an offer without a connection": with_headers(b"upgrade: h2c"),
    "a list in two headers": with_headers(b"accept: application/json"),
    "the same unknown header twice": with_headers(b"x-thing: 1", b"x-thing: 2"),
    "another expectation": with_headers(b"expect: something-else"),
    "a host with a port": replaced(b"host: test", b"host: [::1]:8000"),
    "an empty host": replaced(b"host: test", b"host:"),
    "upper case": lambda line, headers, body: request(
        line, [b": ".join((one.split(b": ")[0].upper(), one.split(b": ")[1])) for one in headers], body
    ),
    "spaces around a value": replaced(b"host: test", b"host:\t test \t"),
    "an absolute target": replaced(b" /v1", b" http://other.example/v1"),
    "a target in per cents": replaced(b"/v1/", b"/%76%31/"),
    "a fragment": replaced(b" HTTP", b"#part HTTP"),
    "a query": replaced(b" HTTP", b"?a=b HTTP"),
    "empty lines before": lambda line, headers, body: b"\r\n\r\n\r\n" + request(line, headers, body),
}
CLOSING: dict[str, Form] = {
    "a client that leaves": with_headers(b"connection: close"),
    "an older version": replaced(b"HTTP/1.1", b"HTTP/1.0"),
    "an older version without a host": lambda line, headers, body: request(
        line.replace(b"1.1", b"1.0"), [one for one in headers if not one.startswith(b"host")], body
    ),
    "an older version that stays": lambda line, headers, body: request(
        line.replace(b"1.1", b"1.0"), [*headers, b"connection: keep-alive"], body
    ),
}
REFUSED: dict[str, tuple[Form, int]] = {
    "no host": (without(b"host"), 400),
    "no host and a whole URL": (
        lambda line, headers, body: request(line.replace(b" /", b" http://a/"), headers[:-3] + headers[-2:], body),
        400,
    ),
    "a host that is none": (replaced(b"host: test", b"host: test/livez?"), 400),
    "a host with a name of a user": (replaced(b"host: test", b"host: user@test"), 400),
    "two hosts": (with_headers(b"host: other"), 400),
    "the same host twice": (with_headers(b"host: test"), 400),
    "two types": (with_headers(b"content-type: text/plain"), 400),
    "the same type twice": (with_headers(JSON), 400),
    "two keys": (with_headers(b"authorization: Bearer a", b"authorization: Bearer b"), 400),
    "two lengths": (with_headers(b"content-length: 3"), 400),
    "two lengths of tensors": (
        with_headers(b"inference-header-content-length: 1", b"inference-header-content-length: 2"),
        400,
    ),
    "a length and chunks": (with_headers(b"transfer-encoding: chunked"), 400),
    "another coding": (replaced(b"content-length: ", b"transfer-encoding: gzip\r\nx-l: "), 400),
    "two codings in two headers": (
        replaced(b"content-length: ", b"transfer-encoding: gzip\r\ntransfer-encoding: chunked\r\nx-l: "),
        400,
    ),
    "two codings": (replaced(b"content-length: ", b"transfer-encoding: gzip, chunked\r\nx-l: "), 400),
    "chunks of an older version": (
        lambda line, headers, body: chunked()(line.replace(b"1.1", b"1.0"), headers, body),
        400,
    ),
    "a length with a sign": (replaced(b"content-length: ", b"content-length: +"), 400),
    "a list of lengths": (replaced(b"content-length: ", b"content-length: 1, "), 400),
    "bare line feeds": (lambda line, headers, body: request(line, headers, body).replace(b"\r\n", b"\n"), 400),
    "a bare carriage return": (replaced(b"host: test", b"host: te\rst"), 400),
    "a folded header": (replaced(b"host: test", b"host: te\r\n st"), 400),
    "a space before a colon": (replaced(b"host:", b"host :"), 400),
    "a header without a colon": (with_headers(b"nothing"), 400),
    "a zero byte": (with_headers(b"x-a: b\x00c"), 400),
    "a target with a space": (replaced(b"/v1/", b"/v1 /"), 400),
    "a target that is no path": (replaced(b" /v1", b" v1"), 400),
    "a later version": (replaced(b"HTTP/1.1", b"HTTP/1.2"), 400),
    "the next version": (replaced(b"HTTP/1.1", b"HTTP/2.0"), 505),
    "chunks without hex": (chunked(size=b"0x%x"), 400),
    "a space behind a size": (chunked(size=b"%x "), 400),
    "a quote without an end": (chunked(size=b'%x;a="b'), 400),
    "a folded trailer": (chunked(trailers=b"x-a: b\r\n c\r\n"), 400),
    "a trailer without a colon": (chunked(trailers=b"nothing\r\n"), 400),
    "a trailer with a zero byte": (chunked(trailers=b"x-a: \0\r\n"), 400),
    "a trailer with a bare line feed": (chunked(trailers=b"x-a: b\n"), 400),
    "endless trailers": (chunked(trailers=b"x-a: b\r\n" * 3000), 400),
    "endless extensions": (chunked(size=b"%x;" + b"a" * 20000), 400),
}


@pytest.fixture(scope="module")
def models(tmp_path_factory: pytest.TempPathFactory) -> LoadedModels:
    """Return fake models of every kind."""
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


def exchange(
    loop: asyncio.Runner, app: Service, sent: bytes, answers: int = 1, size: int = 1 << 20, half_close: bool = False
) -> tuple[list[bytes], bool]:
    """Send bytes in pieces of a size. Return the answers, and True if the connection ends."""

    async def run() -> tuple[list[bytes], bool]:
        """Send and receive in the event loop."""
        connection = FakeConnection(app, app.shortcut)
        for at in range(0, len(sent), size):
            connection.receive(sent[at : at + size])
        if half_close:
            connection.half_close()
        received = await connection.answers(answers)
        transport = connection.transport
        return whole_answers(received), transport.closed or transport.ended

    return loop.run(run())


def plain(way: str) -> tuple[bytes, list[bytes], bytes]:
    """Return request line, headers and body of the plain request that takes a way."""
    line, headers, body = WAYS[way]
    return line, [*headers, *ALWAYS], body


def without_timing(answer: bytes) -> bytes:
    """Return an answer without the header of its connection."""
    return answer.replace(b"connection: close\r\n", b"")


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("name", ALLOWED | CLOSING)
def test_an_allowed_form_gets_the_answer_of_the_plain_one(
    loop: asyncio.Runner, app: Service, way: str, name: str
) -> None:
    """In one piece and byte by byte, alone, with the next request behind it, and from a client that then is silent."""
    whole = request(*plain(way))
    (expected,), is_closed = exchange(loop, app, whole)
    assert expected.startswith(b"HTTP/1.1 200 OK\r\n")
    assert not is_closed
    sent = (ALLOWED | CLOSING)[name](*plain(way))
    closes = name in CLOSING
    for size in (1 << 20, 1 if len(sent) < 2000 else 61):
        found, is_closed = exchange(loop, app, sent, size=size)
        assert [without_timing(one) for one in found] == [expected]
        assert is_closed is closes
    found, is_closed = exchange(loop, app, sent, half_close=True)
    assert [without_timing(one) for one in found] == [expected]
    if not closes:
        found, _ = exchange(loop, app, sent + whole, answers=2)
        assert found == [expected, expected]


@pytest.mark.parametrize("way", WAYS)
def test_a_client_that_expects_a_word_gets_it_before_the_answer(loop: asyncio.Runner, app: Service, way: str) -> None:
    """A body is asked for, in any spelling, unless there is none or the version is older."""
    line, headers, body = plain(way)

    async def run(sent: bytes) -> bytes:
        """Send a request in the event loop. Return the bytes of the answer."""
        connection = FakeConnection(app, app.shortcut)
        connection.receive(sent)
        return await connection.answers(1)

    for value in (b"100-continue", b"100-Continue"):
        expecting = [*headers, b"expect: " + value]
        assert loop.run(run(request(line, expecting, body))).startswith(b"HTTP/1.1 100 Continue\r\n\r\nHTTP/1.1 200 ")
        assert loop.run(run(request(line, expecting, b""))).startswith((b"HTTP/1.1 4", b"HTTP/1.1 200"))
        assert loop.run(run(request(line.replace(b"1.1", b"1.0"), expecting, body))).startswith(b"HTTP/1.1 200 ")


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("name", REFUSED)
def test_a_refused_form_gets_one_status(loop: asyncio.Runner, app: Service, way: str, name: str) -> None:
    """The refusal is a problem with an id, and behind the answer before it."""
    form, status = REFUSED[name]
    whole = request(*plain(way))
    (expected,), _ = exchange(loop, app, whole)
    sent = form(*plain(way))
    for pieces, before in ((1 << 20, b""), (1 if len(sent) < 2000 else 61, b""), (1 << 20, whole)):
        found, _ = exchange(loop, app, before + sent, answers=1 + bool(before), size=pieces)
        assert found[: len(found) - 1] == [expected] * bool(before)
        head, _, body = found[-1].partition(b"\r\n\r\n")
        assert int(head.split()[1]) == status, (pieces, found[-1])
        assert b"\r\nx-request-id: " in head
        assert json.loads(body)["status"] == status
        assert json.loads(body)["code"] == "malformed_request"
        assert b"traceback" not in body.lower()


@pytest.mark.parametrize("way", WAYS)
def test_a_key_in_a_trailer_opens_no_door(loop: asyncio.Runner, models: LoadedModels, tmp_path: Path, way: str) -> None:
    """With keys on, a key among the trailers is none, and the request is refused before its body is read."""
    grant, key = Grant.new("robot", frozenset({Scope.PREDICT}))
    (tmp_path / "keys").write_text(grant.line() + "\n")
    app = create_app(Settings(poll_interval_s=3600, keys=tmp_path / "keys"), models, log=RequestLog(io.StringIO()))
    trailer = b"authorization: Bearer %b\r\n" % key.encode()
    (answer,), is_closed = exchange(loop, app, chunked(trailers=trailer)(*plain(way)))
    assert answer.startswith(b"HTTP/1.1 401 ")
    line, headers, body = plain(way)
    head = request(line, headers, body)[: -len(body)]
    (answer,), is_closed = exchange(loop, app, head)
    assert answer.startswith(b"HTTP/1.1 401 ")
    assert b"connection: close" in answer
    assert is_closed
    (answer,), _ = exchange(loop, app, with_headers(b"authorization: Bearer %b" % key.encode())(line, headers, body))
    assert answer.startswith(b"HTTP/1.1 200 ")


def test_a_refused_method_names_those_that_are_allowed(loop: asyncio.Runner, app: Service) -> None:
    """A route of GET allows HEAD too."""
    for path, allowed in (("/v1/models", b"GET, HEAD"), ("/v1/predict", b"POST")):
        sent = f"DELETE {path} HTTP/1.1\r\nhost: a\r\n\r\n".encode()
        (answer,), _ = exchange(loop, app, sent)
        assert answer.startswith(b"HTTP/1.1 405 ")
        assert b"\r\nallow: %b\r\n" % allowed in answer


GETS = ("/livez", "/readyz", "/metrics", "/docs", "/openapi.json", "/v1/models", "/v2", "/v2/health/ready", "/nothing")


@pytest.mark.parametrize("path", GETS)
def test_head_is_wherever_get_is(loop: asyncio.Runner, app: Service, path: str) -> None:
    """HEAD gets the head of GET, and no body: the next answer follows at once."""
    get = f"GET {path} HTTP/1.1\r\nhost: a\r\nx-request-id: the-same\r\n\r\n".encode()

    async def run() -> bytes:
        """Send HEAD, then GET."""
        connection = FakeConnection(app, app.shortcut)
        connection.receive(get.replace(b"GET", b"HEAD") + get)
        async with asyncio.timeout(60):
            while not (connection.protocol.is_idle() and connection.transport.sent):
                await asyncio.sleep(0.001)
        return b"".join(connection.transport.sent)

    first, second, body = loop.run(run()).split(b"\r\n\r\n", 2)
    if path != "/metrics":
        assert first == second
    assert first.split()[1] == second.split()[1] == (b"404" if path == "/nothing" else b"200")
    assert body


@pytest.mark.parametrize(
    ("line", "status"),
    [
        (b"OPTIONS * HTTP/1.1", 404),
        (b"GET * HTTP/1.1", 404),
        (b"CONNECT a:443 HTTP/1.1", 400),
        (b"GET http://a HTTP/1.1", 404),
        (b"GET //evil/livez HTTP/1.1", 404),
        (b"PRI * HTTP/2.0", 400),
        (b"BREW /livez HTTP/1.1", 400),
        (b"get /livez HTTP/1.1", 400),
        (b"GET /%ff%00/%2e%2e/livez HTTP/1.1", 404),
    ],
)
def test_odd_request_lines_get_a_status(loop: asyncio.Runner, app: Service, line: bytes, status: int) -> None:
    """Targets and methods that no route has get a 404, and those that are none a 400."""
    (answer,), _ = exchange(loop, app, line + b"\r\nhost: a\r\n\r\n")
    assert int(answer.split()[1]) == status
    assert b"x-request-id: " in answer


def test_a_request_that_ends_early_is_refused(loop: asyncio.Runner, app: Service) -> None:
    """A client that shuts its sending half within a request gets a 400. Before the first byte it has left."""
    heads = [b"GET /livez HTTP/1.1\r\nhost", chunked()(*plain("thread"))[:-1]]
    for sent in [*heads, *(request(*plain(way))[:-1] for way in WAYS)]:
        found, is_closed = exchange(loop, app, sent, half_close=True)
        assert [one.split()[1] for one in found] == [b"400"]
        assert is_closed
    assert exchange(loop, app, b"", half_close=True) == ([], True)


@pytest.mark.parametrize("method", [b"HEAD", b"GET"])
def test_a_client_that_sends_no_more_gets_its_answer_at_any_time(
    loop: asyncio.Runner, app: Service, method: bytes
) -> None:
    """The end of the client's sending half may come in any iteration, also while the head of an answer is held."""

    async def run(iterations: int) -> bytes:
        """Shut the sending half some iterations after a request."""
        connection = FakeConnection(app, app.shortcut)
        connection.receive(method + b" /livez HTTP/1.1\r\nhost: a\r\n\r\n")
        for _ in range(iterations):
            await asyncio.sleep(0)
        connection.half_close()
        async with asyncio.timeout(60):
            while not connection.transport.closed:
                await asyncio.sleep(0.001)
        return b"".join(connection.transport.sent)

    for iterations in range(20):
        assert loop.run(run(iterations)).startswith(b"HTTP/1.1 200 ")


@pytest.mark.parametrize("more", [(), (b"connection: upgrade", b"upgrade: h2c")], ids=["plain", "offer"])
def test_headers_are_bounded_in_number(loop: asyncio.Runner, app: Service, more: tuple[bytes, ...]) -> None:
    """Thousands of short headers would cost every ring time."""
    for way in WAYS:
        line, headers, body = plain(way)
        many = [*headers, *more, *[b"a:"] * MAX_HEADERS]
        room = MAX_HEADERS - 1  # its length is a header too
        (answer,), _ = exchange(loop, app, request(line, many[:room], body))
        assert answer.startswith(b"HTTP/1.1 200 ")
        for excess in (1, 2, 9):  # the length comes last
            (answer,), is_closed = exchange(loop, app, request(line, many[: room + excess], body))
            assert answer.startswith(b"HTTP/1.1 431 ")
            assert is_closed
