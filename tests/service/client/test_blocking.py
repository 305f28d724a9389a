"""Both clients, against a real service process and against servers that mean no good."""

import asyncio
import gzip
import json
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
    ContextBody,
    ProblemError,
    Retries,
    TimedOutError,
    UnreachableError,
    UnreadableAnswerError,
)
from service.client.base import MAX_ANSWER_BYTES
from service.transport.keys import Grant, Scope
from tests.hostile_server import Reply, hostile, reply
from tests.serving import PATIENCE_S, ROOT, free_port, serve

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
    """A key."""
    return Grant.new("robot", frozenset([Scope.PREDICT]))


@pytest.fixture(scope="module")
def url(tmp_path_factory: pytest.TempPathFactory, key: tuple[Grant, str]) -> Iterator[str]:
    """A service that wants a key."""
    folder = tmp_path_factory.mktemp("client")
    (folder / "keys").write_text(key[0].line() + "\n")
    with serve(folder, keys=folder / "keys") as (port, _):
        yield f"http://127.0.0.1:{port}/"


@pytest.fixture
def client(url: str, key: tuple[Grant, str]) -> Iterator[Client]:
    """A blocking client of it."""
    with Client(url, key=key[1], timeout_s=PATIENCE_S) as found:
        yield found


@pytest.fixture(scope="module")
def picture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A top-down view."""
    grey = np.zeros((64, 64), dtype=np.uint8)
    grey[20:44, 18:40] = 128
    path = tmp_path_factory.mktemp("picture") / "view.png"
    Image.fromarray(grey).save(path)
    return path


def test_one_push_is_answered_with_the_services_own_body(client: Client) -> None:
    """With and without a model, as list and as array."""
    answer = client.predict([-0.075, 0.0, 0.0], OBJECT)
    assert (answer.model.name, answer.frame) == ("push-indicator", "object")
    assert answer == client.predict(
        np.array([-0.075, 0.0, 0.0]), ContextBody(descriptor=OBJECT), model=f"push-indicator@{answer.model.version}"
    )


def test_a_batch_is_arrays_in_and_arrays_out(client: Client) -> None:
    """Each row is what that push alone gets, to the bit."""
    batch = client.predict_batch(PUSHERS, OBJECT)
    assert batch.mean.shape == batch.std.shape == (300, 3)
    assert (batch.std > 0).all()
    one = client.predict(PUSHERS[7], OBJECT)
    assert np.array([one.mean.x, one.mean.y, one.mean.angle], dtype=np.float32).tolist() == batch.mean[7].tolist()
    several = client.predict_batch(PUSHERS, [OBJECT, "4a4a4a4a"], np.arange(300) % 2)
    assert (several.mean[::2] == batch.mean[::2]).all()
    assert (several.mean[1::2] != batch.mean[1::2]).any()


def test_poses_in_the_world_give_answers_in_it(client: Client) -> None:
    """With covariances; an object in the origin of the world changes nothing but the frame."""
    world = client.predict_batch(PUSHERS, OBJECT, object_poses=[[0.0, 0.0, 0.0]])
    assert world.frame == "world"
    assert world.covariance is not None
    assert world.covariance.shape == (300, 3, 3)
    assert world.mean == pytest.approx(client.predict_batch(PUSHERS, OBJECT).mean.astype(float), abs=1e-6)
    one = client.predict([0.4, 0.025, 1.5708], OBJECT, object_pose=[0.4, 0.1, 1.5708])
    assert one.covariance is not None


def test_an_image_becomes_a_context_that_is_used_again(client: Client, picture: Path) -> None:
    """As a path or as bytes; the context gives what the image gives."""
    seen = client.make_context(picture)
    assert seen == client.make_context(picture.read_bytes()) == client.make_context(str(picture))
    again = client.predict_batch(PUSHERS, seen)
    assert again.model.name == "push-visual"
    assert (again.mean == client.predict_image(picture, PUSHERS).mean).all()
    assert client.predict_image(picture, PUSHERS, object_poses=[[0.05, 0.0, 0.0]]).frame == "world"


def test_models_can_be_looked_at(client: Client) -> None:
    """All, one, one version."""
    names = [model.name for model in client.list_models().models]
    assert {"push-indicator", "push-visual"} <= set(names)
    assert names == sorted(names)
    assert client.show_model("push-indicator").aliases["champion"] in client.show_model("push-indicator").versions
    assert client.show_version("push-indicator", 1).manifest["name"] == "push-indicator"


def test_the_same_numbers_come_without_a_service(client: Client, project_root: Path) -> None:
    """``Client.local`` over the same model: to the bit."""
    with Client.local(str(project_root / "models")) as local:
        for poses in (None, [[0.01, 0.02, 1.57]]):
            here, there = (c.predict_batch(PUSHERS, OBJECT, object_poses=poses) for c in (local, client))
            assert here.mean.tobytes() == there.mean.tobytes()
            assert here.std.tobytes() == there.std.tobytes()
        assert local.predict(PUSHERS[0], OBJECT) == client.predict(PUSHERS[0], OBJECT)


def test_a_refusal_is_an_exception_with_code_detail_faults_and_request_id(client: Client) -> None:
    """As the service said it."""
    with pytest.raises(ProblemError) as raised:
        client.predict([2.0, 0.0, 0.0], OBJECT)
    problem = raised.value
    assert (problem.status, problem.code) == (422, "invalid_request")
    assert [fault.where for fault in problem.faults] == ["body.pusher.x"]
    assert problem.detail == str(problem.faults[0])
    assert problem.request_id
    with pytest.raises(ProblemError, match="unknown_model"):
        client.predict([0.0, 0.0, 0.0], OBJECT, model="nobody")


def test_a_key_that_is_missing_or_wrong_is_said(url: str) -> None:
    """A 401 is no reason to try again."""
    for key in (None, "wrong"):
        with Client(url, key=key) as client, pytest.raises(ProblemError) as raised:
            client.list_models()
        assert (raised.value.status, raised.value.code) == (401, "missing_key")


def test_asyncio_has_the_same_answers_many_at_once(
    url: str, client: Client, key: tuple[Grant, str], picture: Path
) -> None:
    """Every method, with one client for all tasks."""

    async def scenario() -> None:
        """On one loop."""
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
            for asked, expected in pairs:
                assert await asked == expected
            image = await concurrent.predict_image(picture, PUSHERS)
            assert (image.mean == client.predict_image(picture, PUSHERS).mean).all()
            with pytest.raises(ProblemError, match="unknown_model"):
                await concurrent.show_model("nobody")
        async with AsyncClient.local(str(ROOT / "models")) as local:
            batch = await local.predict_batch(PUSHERS, OBJECT)
            assert batch.mean.tobytes() == client.predict_batch(PUSHERS, OBJECT).mean.tobytes()

    asyncio.run(scenario())


def blocking(url: str, **options: Any) -> Any:
    """One push, asked by the blocking client."""
    with Client(url, **options) as client:
        return client.predict([0.0, 0.0, 0.0], OBJECT)


def concurrent(url: str, **options: Any) -> Any:
    """The same by the other."""

    async def ask() -> Any:
        """On a loop of its own."""
        async with AsyncClient(url, **options) as client:
            return await client.predict([0.0, 0.0, 0.0], OBJECT)

    return asyncio.run(ask())


both = pytest.mark.parametrize("ask", [blocking, concurrent])


@both
def test_a_storm_of_503_is_outlived(ask: Ask) -> None:
    """Three refusals, then an answer: the caller sees the answer."""
    with hostile([BUSY, BUSY, BUSY, FINE]) as (url, seen):
        assert ask(url, retries=AT_ONCE).model.version == 1
    assert len(seen.heads) == 4


@both
def test_a_storm_that_does_not_end_is_told_after_so_many_attempts(ask: Ask) -> None:
    """With the last refusal's code."""
    with hostile([BUSY]) as (url, seen), pytest.raises(ProblemError) as raised:
        ask(url, retries=Retries(attempts=3, first_s=0.0))
    assert (raised.value.code, raised.value.request_id, raised.value.retry_after_s) == ("overloaded", "42", 0.0)
    assert len(seen.heads) == 3


@both
def test_a_503_without_a_problem_is_asked_again_too(ask: Ask) -> None:
    """A proxy's, while the service behind it restarts."""
    with hostile([reply("503 Service Unavailable", b"<html>"), FINE]) as (url, seen):
        assert ask(url, retries=AT_ONCE).model.version == 1
    assert len(seen.heads) == 2


@both
def test_a_long_retry_after_is_told_instead_of_waited_for(ask: Ask) -> None:
    """An hour is the caller's decision."""
    long = reply("503 Service Unavailable", PROBLEM, "Retry-After: 3600")
    with hostile([long]) as (url, seen), pytest.raises(ProblemError) as raised:
        ask(url)
    assert raised.value.retry_after_s == 3600.0
    assert len(seen.heads) == 1


@both
@pytest.mark.parametrize("status", ["500 Internal Server Error", "502 Bad Gateway", "429 Too Many Requests", "799 Odd"])
def test_nothing_else_is_asked_again(ask: Ask, status: str) -> None:
    """Once, and the status in words."""
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
def test_garbage_is_no_answer(ask: Ask, answer: Reply) -> None:
    """A page, nothing, other JSON, a bomb of brackets, half an answer, a packed one: one exception, once."""
    with hostile([answer]) as (url, seen), pytest.raises(UnreadableAnswerError, match="/v1/predict"):
        ask(url)
    assert len(seen.heads) == 1


@both
def test_a_redirect_is_not_followed(ask: Ask) -> None:
    """A key must not travel to where an answer points."""
    with (
        hostile([reply("307 Temporary Redirect", b"", "Location: http://127.0.0.1:9/")]) as (url, seen),
        pytest.raises(ProblemError, match="307"),
    ):
        ask(url, key="secret")
    assert len(seen.heads) == 1


@both
@pytest.mark.parametrize(
    "parts",
    [[b"", b"HTTP"], [b"HTTP/1.1 200 OK\r\nContent-Length: 1000\r\n\r\n", *([b"{"] * 1000)]],
    ids=["never begins", "never ends"],
)
def test_a_slow_answer_is_given_up_on(ask: Ask, parts: Reply) -> None:
    """Though every byte comes in time, the answer as a whole does not."""
    slow = [parts[0], *([b""] * 100), *parts[1:]]
    with hostile([slow]) as (url, _), pytest.raises(TimedOutError, match=r"within 0\.3 s"):
        ask(url, timeout_s=0.3)


@both
@pytest.mark.parametrize(
    "parts",
    [[], [b"HTTP/1.1 200 OK\r\nContent-Length: 1000\r\n\r\n{"], [b"SSH-2.0-OpenSSH\r\n"]],
    ids=["hangs up", "hangs up half-way", "speaks no HTTP"],
)
def test_a_broken_connection_is_said(ask: Ask, parts: Reply) -> None:
    """Whether it was answered is not known, so it is not asked again."""
    with hostile([parts]) as (url, seen), pytest.raises(UnreachableError, match="cannot be asked"):
        ask(url)
    assert len(seen.heads) == 1


@both
def test_nobody_there_is_said_with_what_to_do(ask: Ask) -> None:
    """A port that nobody listens on."""
    with pytest.raises(UnreachableError, match="is the service running"):
        ask(f"http://127.0.0.1:{free_port()}")


def test_an_answer_without_an_end_is_cut() -> None:
    """However fast it comes."""

    class Endless(httpx2.SyncByteStream):
        """A server that never stops."""

        def __iter__(self) -> Iterator[bytes]:
            while True:
                yield bytes(1 << 20)

    endless = httpx2.MockTransport(lambda _: httpx2.Response(200, stream=Endless()))
    client = Client(http=httpx2.Client(transport=endless))
    with client, pytest.raises(UnreadableAnswerError, match=str(MAX_ANSWER_BYTES)):
        client.list_models()


def test_requests_say_who_asks_and_take_no_packed_answer() -> None:
    """For the service's log; and what is packed may be of any size inside."""
    with hostile([FINE]) as (url, seen):
        blocking(url, key="secret")
    head = seen.heads[0].lower()
    assert "user-agent: cazsl/" in head
    assert "accept-encoding: identity" in head
    assert "authorization: bearer secret" in head
