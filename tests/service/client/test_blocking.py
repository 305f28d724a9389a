"""Tests of both clients against a real service process and against hostile servers."""

import asyncio
import contextlib
import gc
import gzip
import json
import os
import socket
import struct
import threading
import tracemalloc
import warnings
from collections.abc import Awaitable, Callable, Iterator
from pathlib import Path
from typing import Any

import httpx2
import numpy as np
import pytest
from PIL import Image

from service.client import (
    AsyncClient,
    Client,
    ClientError,
    ClientSetupError,
    ContextBody,
    ProblemError,
    Retries,
    TimedOutError,
    UnreachableError,
    UnreadableAnswerError,
    calls,
)
from service.client.calls import MAX_CATALOGUE_BYTES
from service.transport.keys import Grant, Scope
from tests.hostile_server import Reply, hostile, reply
from tests.running_service import PATIENCE_S, ROOT, free_port, serve
from tests.service.schemas.test_shapes import blank_picture

PUSHERS = np.random.default_rng(0).uniform(-0.1, 0.1, (300, 3))
OBJECT = "1a2b3c4a"
AT_ONCE = Retries(first_s=0.0)
ANSWER = json.dumps(
    {
        "model": {"name": "push-indicator", "version": 1},
        "frame": "object",
        "mean": {"x": 0.0, "y": 0.0, "angle": 0.0},
        "std": {"x": 1.0, "y": 1.0, "angle": 1.0},
    }
).encode()
PROBLEM = json.dumps(
    {
        "type": "urn:cazsl:problem:overloaded",
        "title": "Too much to do",
        "status": 503,
        "code": "overloaded",
        "detail": "try again",
        "errors": [],
        "request_id": "42",
    }
).encode()
BUSY = reply("503 Service Unavailable", PROBLEM, "Retry-After: 0")
FINE = reply("200 OK", ANSWER)

Ask = Callable[..., Any]


@pytest.fixture(scope="module")
def key() -> tuple[Grant, str]:
    """An API key with the scope predict."""
    return Grant.new("robot", frozenset([Scope.PREDICT]))


@pytest.fixture(scope="module")
def url(tmp_path_factory: pytest.TempPathFactory, key: tuple[Grant, str]) -> Iterator[str]:
    """The address of a service that requires an API key."""
    folder = tmp_path_factory.mktemp("client")
    (folder / "keys").write_text(key[0].line() + "\n")
    with serve(folder, keys=folder / "keys") as (port, _):
        yield f"http://127.0.0.1:{port}/"


@pytest.fixture
def client(url: str, key: tuple[Grant, str]) -> Iterator[Client]:
    """A blocking client of that service."""
    with Client(url, key=key[1], timeout_s=PATIENCE_S) as found:
        yield found


@pytest.fixture(scope="module")
def picture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The file of a top-down view."""
    grey = np.zeros((64, 64), dtype=np.uint8)
    grey[20:44, 18:40] = 128
    path = tmp_path_factory.mktemp("picture") / "view.png"
    Image.fromarray(grey).save(path)
    return path


def test_predict_returns_the_body_of_the_service(client: Client) -> None:
    """One push gets the same body with and without a model, from a list and from an array."""
    answer = client.predict([-0.075, 0.0, 0.0], OBJECT)
    assert (answer.model.name, answer.frame) == ("push-indicator", "object")
    assert answer == client.predict(
        np.array([-0.075, 0.0, 0.0]), ContextBody(descriptor=OBJECT), model=f"push-indicator@{answer.model.version}"
    )


def test_batch_takes_and_returns_arrays(client: Client) -> None:
    """Each row of a batch equals the prediction of that push alone, to the bit."""
    batch = client.predict_batch(PUSHERS, OBJECT)
    assert batch.mean.shape == batch.std.shape == (300, 3)
    assert (batch.std > 0).all()
    one = client.predict(PUSHERS[7], OBJECT)
    assert np.array([one.mean.x, one.mean.y, one.mean.angle], dtype=np.float32).tolist() == batch.mean[7].tolist()
    several = client.predict_batch(PUSHERS, [OBJECT, "4a4a4a4a"], np.arange(300) % 2)
    assert (several.mean[::2] == batch.mean[::2]).all()
    assert (several.mean[1::2] != batch.mean[1::2]).any()


def test_object_poses_give_predictions_in_the_world_frame(client: Client) -> None:
    """Object poses give predictions in the world frame with covariances. An object at the origin keeps its numbers."""
    world = client.predict_batch(PUSHERS, OBJECT, object_poses=[[0.0, 0.0, 0.0]])
    assert world.frame == "world"
    assert world.covariance is not None
    assert world.covariance.shape == (300, 3, 3)
    assert world.mean == pytest.approx(client.predict_batch(PUSHERS, OBJECT).mean.astype(float), abs=1e-6)
    one = client.predict([0.4, 0.025, 1.5708], OBJECT, object_pose=[0.4, 0.1, 1.5708])
    assert one.covariance is not None


def test_image_is_converted_to_a_reusable_context(client: Client, picture: Path) -> None:
    """An image, as a path or as bytes, becomes a context that gives the predictions of the image."""
    seen = client.make_context(picture)
    assert seen == client.make_context(picture.read_bytes()) == client.make_context(str(picture))
    again = client.predict_batch(PUSHERS, seen)
    assert again.model.name == "push-visual"
    assert (again.mean == client.predict_image(picture, PUSHERS).mean).all()
    assert client.predict_image(picture, PUSHERS, object_poses=[[0.05, 0.0, 0.0]]).frame == "world"


def test_faults_of_an_image_come_with_the_prediction(client: Client) -> None:
    """A picture of nothing is answered with its flag, through a file and through the context that is made of it."""
    nothing = blank_picture()
    assert client.make_context(nothing).flags == ["blank"]
    for answer in (client.predict_image(nothing, PUSHERS), client.predict_batch(PUSHERS, client.make_context(nothing))):
        blank = [warning for warning in answer.warnings if warning.code == "image_blank"]
        assert [warning.rows for warning in blank] == [list(range(len(PUSHERS)))]


def test_models_and_versions_are_listed(client: Client) -> None:
    """The client lists all models, shows one model, and shows one version with its manifest."""
    names = [model.name for model in client.list_models().models]
    assert {"push-indicator", "push-visual"} <= set(names)
    assert names == sorted(names)
    assert client.show_model("push-indicator").aliases["champion"] in client.show_model("push-indicator").versions
    assert client.show_version("push-indicator", 1).manifest["name"] == "push-indicator"


def test_local_client_returns_the_same_numbers(client: Client, project_root: Path) -> None:
    """A local client over the same registry returns the numbers of the service, to the bit."""
    with Client.local(str(project_root / "models")) as local:
        for poses in (None, [[0.01, 0.02, 1.57]]):
            here, there = (c.predict_batch(PUSHERS, OBJECT, object_poses=poses) for c in (local, client))
            assert here.mean.tobytes() == there.mean.tobytes()
            assert here.std.tobytes() == there.std.tobytes()
        assert local.predict(PUSHERS[0], OBJECT) == client.predict(PUSHERS[0], OBJECT)


def test_refused_request_is_a_problem_error(client: Client) -> None:
    """A refused request is a ProblemError with the code, detail, faults and request id of the service."""
    with pytest.raises(ProblemError) as raised:
        client.predict([2.0, 0.0, 0.0], OBJECT)
    problem = raised.value
    assert (problem.status, problem.code) == (422, "invalid_request")
    assert [fault.where for fault in problem.faults] == ["body.pusher.x"]
    assert problem.detail == str(problem.faults[0])
    assert problem.request_id
    with pytest.raises(ProblemError, match="unknown_model"):
        client.predict([0.0, 0.0, 0.0], OBJECT, model="absent")


def test_missing_or_wrong_key_is_refused_once(url: str) -> None:
    """A missing or wrong key is a ProblemError with status 401, and is not retried."""
    for key in (None, "wrong"):
        with Client(url, key=key) as client, pytest.raises(ProblemError) as raised:
            client.list_models()
        assert (raised.value.status, raised.value.code) == (401, "missing_key")


def test_asyncio_client_returns_the_same_answers(
    url: str, client: Client, key: tuple[Grant, str], picture: Path
) -> None:
    """Every method of one asyncio client, shared by many tasks, returns the answers of the blocking client."""

    async def scenario() -> None:
        """Ask for twenty batches at once."""
        async with AsyncClient(url, key=key[1], timeout_s=PATIENCE_S) as concurrent:
            batches = await asyncio.gather(*(concurrent.predict_batch(PUSHERS, OBJECT) for _ in range(20)))
            assert all((batch.mean == batches[0].mean).all() for batch in batches)
            seen = await concurrent.make_context(picture)
            pairs: list[tuple[Awaitable[Any], Any]] = [
                (concurrent.predict(PUSHERS[0], OBJECT), client.predict(PUSHERS[0], OBJECT)),
                (concurrent.predict(PUSHERS[0], seen), client.predict(PUSHERS[0], seen)),
                (concurrent.list_models(), client.list_models()),
                (concurrent.show_model("push-visual"), client.show_model("push-visual")),
                (concurrent.show_version("push-visual", 1), client.show_version("push-visual", 1)),
            ]
            for answer, expected in pairs:
                assert await answer == expected
            image = await concurrent.predict_image(picture, PUSHERS)
            assert (image.mean == client.predict_image(picture, PUSHERS).mean).all()
            with pytest.raises(ProblemError, match="unknown_model"):
                await concurrent.show_model("absent")
        async with AsyncClient.local(str(ROOT / "models")) as local:
            batch = await local.predict_batch(PUSHERS, OBJECT)
            assert batch.mean.tobytes() == client.predict_batch(PUSHERS, OBJECT).mean.tobytes()

    asyncio.run(scenario())


def blocking(url: str, **options: Any) -> Any:
    """Predict one push with the blocking client."""
    with Client(url, **options) as client:
        return client.predict([0.0, 0.0, 0.0], OBJECT)


def concurrent(url: str, **options: Any) -> Any:
    """Predict one push with the asyncio client."""

    async def ask() -> Any:
        """Ask for one prediction."""
        async with AsyncClient(url, **options) as client:
            return await client.predict([0.0, 0.0, 0.0], OBJECT)

    return asyncio.run(ask())


both = pytest.mark.parametrize("ask", [blocking, concurrent])


@both
def test_several_503_are_retried(ask: Ask) -> None:
    """After three answers of 503 the client returns the answer of the fourth request."""
    with hostile([BUSY, BUSY, BUSY, FINE]) as (url, seen):
        assert ask(url, retries=AT_ONCE).model.version == 1
    assert len(seen.heads) == 4


@both
def test_last_503_is_raised_after_all_attempts(ask: Ask) -> None:
    """After the last attempt a 503 is raised as a ProblemError with its code, request id and Retry-After."""
    with hostile([BUSY]) as (url, seen), pytest.raises(ProblemError) as raised:
        ask(url, retries=Retries(attempts=3, first_s=0.0))
    assert (raised.value.code, raised.value.request_id, raised.value.retry_after_s) == ("overloaded", "42", 0.0)
    assert len(seen.heads) == 3


@both
def test_503_of_a_proxy_is_retried(ask: Ask) -> None:
    """A 503 without a problem document, as a proxy sends it, is retried."""
    with hostile([reply("503 Service Unavailable", b"<html>"), FINE]) as (url, seen):
        assert ask(url, retries=AT_ONCE).model.version == 1
    assert len(seen.heads) == 2


@both
def test_long_retry_after_is_raised_at_once(ask: Ask) -> None:
    """A 503 with a Retry-After of an hour is raised without a retry."""
    long = reply("503 Service Unavailable", PROBLEM, "Retry-After: 3600")
    with hostile([long]) as (url, seen), pytest.raises(ProblemError) as raised:
        ask(url)
    assert raised.value.retry_after_s == 3600.0
    assert len(seen.heads) == 1


@both
@pytest.mark.parametrize("status", ["500 Internal Server Error", "502 Bad Gateway", "429 Too Many Requests", "799 Odd"])
def test_other_statuses_are_not_retried(ask: Ask, status: str) -> None:
    """An error status other than 503 is raised after one request."""
    with hostile([reply(status, b"<html>", "Retry-After: 0")]) as (url, seen), pytest.raises(ProblemError) as raised:
        ask(url)
    assert (raised.value.status, raised.value.code) == (int(status[:3]), "unexplained")
    assert len(seen.heads) == 1


@both
@pytest.mark.parametrize(
    "answer",
    [
        reply("200 OK", b"<html>It works!"),
        reply("200 OK", b""),
        reply("200 OK", b"{}"),
        reply("200 OK", b"[" * 100_000),
        reply("200 OK", b"\xff\xfe\x00"),
        reply("200 OK", ANSWER[:-10]),
        reply("200 OK", gzip.compress(ANSWER), "Content-Encoding: gzip"),
    ],
)
def test_unreadable_answer_is_raised_once(ask: Ask, answer: Reply) -> None:
    """An answer that is HTML, empty, other JSON, deeply nested, truncated or compressed is an UnreadableAnswerError."""
    with hostile([answer]) as (url, seen), pytest.raises(UnreadableAnswerError, match="/v1/predict"):
        ask(url)
    assert len(seen.heads) == 1


@both
def test_redirect_is_not_followed(ask: Ask) -> None:
    """A redirect is not followed, so the API key is sent to no other host."""
    with (
        hostile([reply("307 Temporary Redirect", b"", "Location: http://127.0.0.1:9/")]) as (url, seen),
        pytest.raises(ProblemError, match="307"),
    ):
        ask(url, key="secret")
    assert len(seen.heads) == 1


@both
@pytest.mark.parametrize(
    "parts",
    [
        [b"", b"HTTP"],
        [b"HTTP/1.1 200 OK\r\nContent-Length: 1000\r\n\r\n", *([b"{"] * 1000)],
        [b"HTTP/1.1 200 OK\r\nX: ", *([b"x"] * 1000)],
        [b"HTTP/1.1 100 Continue\r\n\r\n"] * 1000,
    ],
    ids=["never begins", "never ends", "head never ends", "informational answers never end"],
)
def test_slow_answer_times_out(ask: Ask, parts: Reply) -> None:
    """An answer that is late as a whole times out, even if each of its bytes arrives in time."""
    slow = [parts[0], *([b""] * 100), *parts[1:]] if len(parts) == 2 else parts
    with hostile([slow]) as (url, _), pytest.raises(TimedOutError, match=r"within 0\.3 s"):
        ask(url, timeout_s=0.3)


@both
@pytest.mark.parametrize(
    "parts",
    [[], [b"HTTP/1.1 200 OK\r\nContent-Length: 1000\r\n\r\n{"], [b"SSH-2.0-OpenSSH\r\n"]],
    ids=["hangs up", "hangs up half-way", "speaks no HTTP"],
)
def test_broken_connection_is_an_error(ask: Ask, parts: Reply) -> None:
    """A broken connection is an UnreachableError and is not retried, because the request may have been handled."""
    with hostile([parts]) as (url, seen), pytest.raises(UnreachableError, match="cannot be reached"):
        ask(url)
    assert len(seen.heads) == 1


@both
def test_closed_port_is_an_error_with_advice(ask: Ask) -> None:
    """A closed port is an UnreachableError that asks whether the service is running."""
    with pytest.raises(UnreachableError, match="is the service running"):
        ask(f"http://127.0.0.1:{free_port()}")


def test_endless_answer_is_cut_at_the_size_limit() -> None:
    """An answer without end is an UnreadableAnswerError at the size limit."""

    class Endless(httpx2.SyncByteStream):
        """A body without end."""

        def __iter__(self) -> Iterator[bytes]:
            while True:
                yield bytes(1 << 20)

    endless = httpx2.MockTransport(lambda _: httpx2.Response(200, stream=Endless()))
    client = Client(http=httpx2.Client(transport=endless))
    with client, pytest.raises(UnreadableAnswerError, match=str(MAX_CATALOGUE_BYTES)):
        client.list_models()


def test_request_headers_name_the_client_and_refuse_compression() -> None:
    """A request names the client and its version, refuses compressed answers, and carries the API key."""
    with hostile([FINE]) as (url, seen):
        blocking(url, key="secret")
    head = seen.heads[0].lower()
    assert "user-agent: cazsl/" in head
    assert "accept-encoding: identity" in head
    assert "authorization: bearer secret" in head


@both
def test_retries_and_pauses_end_with_the_timeout(ask: Ask) -> None:
    """A pause that would outlast the timeout is not begun: the last 503 is raised."""
    asks_for_a_minute = reply("503 Service Unavailable", PROBLEM, "Retry-After: 60")
    with hostile([asks_for_a_minute]) as (url, seen), pytest.raises(ProblemError, match="overloaded"):
        ask(url, timeout_s=5.0, retries=Retries(longest_s=120.0))
    assert len(seen.heads) == 1


@contextlib.contextmanager
def one_answer_per_connection(reset: bool) -> Iterator[str]:
    """Run a server that keeps each connection open after its first answer, and ends it at the second request."""
    with socket.create_server(("127.0.0.1", 0)) as listener:

        def answer() -> None:
            """Answer one request of each connection."""
            while True:
                connection, _ = listener.accept()
                with connection:
                    if not read_request(connection):
                        return
                    connection.sendall(FINE[0].replace(b"Connection: close\r\n", b""))
                    read_request(connection)
                    if reset:
                        connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))

        thread = threading.Thread(target=answer)
        thread.start()
        try:
            yield f"http://127.0.0.1:{listener.getsockname()[1]}"
        finally:
            socket.create_connection(listener.getsockname()).close()
            thread.join()


def read_request(connection: socket.socket) -> bytes:
    """Read one request with a body in JSON. Empty if the client closed the connection."""
    received = b""
    while not received.endswith(b"}"):
        part = connection.recv(65536)
        if not part:
            return b""
        received += part
    return received


@pytest.mark.parametrize("reset", [False, True], ids=["closed", "reset"])
def test_idle_connection_that_ends_is_replaced(reset: bool) -> None:
    """A request on an idle connection that the service ends at the same time is sent again on a new one."""
    with one_answer_per_connection(reset) as url, Client(url, timeout_s=PATIENCE_S) as client:
        assert [client.predict([0.0, 0.0, 0.0], OBJECT).model.version for _ in range(4)] == [1] * 4

    async def scenario(url: str) -> None:
        """Ask four times on one client."""
        async with AsyncClient(url, timeout_s=PATIENCE_S) as client:
            assert [(await client.predict([0.0, 0.0, 0.0], OBJECT)).model.version for _ in range(4)] == [1] * 4

    with one_answer_per_connection(reset) as url:
        asyncio.run(scenario(url))


@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # Python 3.12 warns of a fork beside threads
def test_forked_process_and_later_event_loop_get_their_own_connections(url: str, key: tuple[Grant, str]) -> None:
    """A client that has an open connection is used by a forked process, and by several event loops."""
    with Client(url, key=key[1], timeout_s=PATIENCE_S) as client:
        expected = client.predict(PUSHERS[0], OBJECT)
        parent = client._connections.http
        child = os.fork()
        if child == 0:
            try:
                is_own = client.predict(PUSHERS[0], OBJECT) == expected and client._connections.http is not parent
                os._exit(0 if is_own else 1)
            finally:
                os._exit(2)
        assert os.waitpid(child, 0)[1] == 0
        assert client.predict(PUSHERS[0], OBJECT) == expected
        assert client._connections.http is parent
    later: list[AsyncClient] = [AsyncClient(url, key=key[1], timeout_s=PATIENCE_S)]
    for _ in range(3):
        assert asyncio.run(later[0].predict(PUSHERS[0], OBJECT)) == expected
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ResourceWarning)  # connections of a loop that has ended cannot be closed in it
        later.clear()
        gc.collect()


@both
def test_closed_client_is_unreachable(ask: Ask) -> None:
    """A call on a client that is closed is an error of the client."""

    async def close_and_ask() -> None:
        """Ask with a closed client of asyncio."""
        closed = AsyncClient()
        await closed.close()
        await closed.list_models()

    client = Client()
    client.close()
    with pytest.raises(UnreachableError, match="closed"):
        client.list_models() if ask is blocking else asyncio.run(close_and_ask())


@both
@pytest.mark.parametrize("timeout_s", [0, -1.0, float("nan")])
def test_timeout_is_a_positive_number(ask: Ask, timeout_s: float) -> None:
    """A timeout that is no positive number is refused by its name."""
    with pytest.raises(ClientSetupError, match="timeout_s: received"):
        ask("http://127.0.0.1:9", timeout_s=timeout_s)


@both
@pytest.mark.parametrize("timeout_s", [float("inf"), 1e300])
def test_no_timeout_is_taken(ask: Ask, timeout_s: float) -> None:
    """A timeout of infinity is none."""
    with hostile([FINE]) as (url, _):
        assert ask(url, timeout_s=timeout_s).model.version == 1


@both
@pytest.mark.parametrize("proxy", ["http://a..b:1", f"http://{'a' * 64}:1", "http://127.0.0.1:70000"])
def test_proxy_that_no_socket_takes_is_unreachable(ask: Ask, proxy: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """A proxy whose name or port is none for a socket is an error of the client."""
    monkeypatch.setenv("HTTP_PROXY", proxy)
    with pytest.raises(UnreachableError, match="cannot be reached"):
        ask("http://robots.example")


@both
@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("HTTP_PROXY", "gopher://proxy:70", "HTTP_PROXY"),
        ("ALL_PROXY", "http://proxy:port", "ALL_PROXY"),
        ("HTTP_PROXY", "http://pro\nxy", "HTTP_PROXY"),
        ("ALL_PROXY", "socks5://proxy:1080", "socksio"),
        ("SSL_CERT_FILE", "/absent.pem", "SSL_CERT_FILE"),
        ("SSL_CERT_FILE", "/", "SSL_CERT_FILE"),
        ("SSL_CERT_FILE", __file__, "SSL_CERT_FILE"),
    ],
)
def test_unusable_environment_is_an_error_that_names_it(
    ask: Ask, name: str, value: str, said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A proxy or certificate of the environment that cannot be used is a ClientSetupError that names the variable."""
    monkeypatch.setenv(name, value)
    with pytest.raises(ClientSetupError, match=said):
        ask("http://example.com")


@both
@pytest.mark.parametrize(
    ("exempt", "proxy"),
    [
        ("127.0.0.1", "http://127.0.0.1:9"),
        ("127.0.0.0/8", "http://127.0.0.1:9"),
        ("127.0.0.1", "gopher://proxy:70"),
        ("*", "gopher://proxy:70"),
        ("127.0.0.1:{port}", "gopher://proxy:70"),
        ("other.example, 127.0.0.1", "socks5://proxy:1080"),
    ],
)
def test_no_proxy_exempts_the_service(ask: Ask, exempt: str, proxy: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """An address in no_proxy is asked directly, also if the proxy could not be used."""
    monkeypatch.setenv("http_proxy", proxy)
    with hostile([FINE]) as (url, _):
        monkeypatch.setenv("no_proxy", exempt.replace("{port}", url.rpartition(":")[2]))
        assert ask(url).model.version == 1


@both
@pytest.mark.parametrize("key", ["", " key", "key\n", "k\r\nX: y", "schlüssel", "\0"])
def test_unusable_key_is_refused_without_a_request(ask: Ask, key: str) -> None:
    """A key with characters that no header may have is refused before a request, and is not shown."""
    with hostile([FINE]) as (url, seen), pytest.raises(ClientSetupError, match="key: received"):
        ask(url, key=key)
    assert not seen.heads


@pytest.mark.parametrize("value", ["0", "[]", "{}", "null", '"x"', "[0]", "[[0]]"])
@pytest.mark.parametrize("field", ["mean", "covariance", "model", "errors", "models", "versions", "unknown"])
def test_wrong_answers_are_parsed_in_bounded_memory(field: str, value: str) -> None:
    """A large wrong answer costs at most 200 times its size, by every call."""
    answer = f'{{"{field}": [{",".join([value] * 50_000)}]}}'.encode()
    made: list[calls.Call[Any]] = [
        calls.predict([0.0, 0.0, 0.0], None, None, None),
        calls.predict_batch(PUSHERS, None, None, None, None),
        calls.make_context(b""),
        calls.list_models(),
        calls.show_model("push-indicator"),
        calls.show_version("push-indicator", 1),
    ]
    for call in made:
        for status in (200, 422):
            tracemalloc.start()
            with pytest.raises(ClientError):
                call.read(status, answer, None)
            peak = tracemalloc.get_traced_memory()[1]
            tracemalloc.stop()
            assert peak < 200 * len(answer)
