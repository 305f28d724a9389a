"""What comes in: bounded bodies, slow clients, how many at once. The ring is driven as a server drives it."""

import asyncio
import json
from collections.abc import Callable
from typing import Any

from starlette.types import Message, Receive, Scope, Send

from service.observability.records import RequestRecord
from service.transport.admission import Admission, AdmissionLimits

PART: Message = {"type": "http.request", "body": b"x" * 100, "more_body": True}
LAST: Message = {"type": "http.request", "body": b"", "more_body": False}
GONE: Message = {"type": "http.disconnect"}


def limits(**changes: Any) -> AdmissionLimits:
    """Small ones."""
    usual = {"body_bytes": 1000, "body_s": 5.0, "in_flight": 2, "in_flight_per_caller": 0, "held_bytes": 10_000}
    return AdmissionLimits(**(usual | changes))


class Endpoint:
    """An app that keeps the bodies that it was given and answers when it is told to."""

    def __init__(self) -> None:
        self.bodies: list[bytes] = []
        self.release = asyncio.Event()
        self.release.set()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer."""
        message = await receive()
        assert not message["more_body"]
        self.bodies.append(message["body"])
        await self.release.wait()
        await send({"type": "http.response.start", "status": 200, "headers": []})
        await send({"type": "http.response.body", "body": b"{}"})


async def ask(
    admission: Admission,
    messages: list[Message],
    headers: list[tuple[bytes, bytes]] | None = None,
    client: str = "10.0.0.1",
) -> tuple[int, dict[bytes, bytes], Any]:
    """Status, headers and document of the answer to these messages; nothing comes after them. Status 0: no answer."""
    sent: list[Message] = []
    waiting = iter(messages)

    async def receive() -> Message:
        """What the client sends."""
        for message in waiting:
            return message
        await asyncio.Event().wait()
        raise AssertionError

    async def send(message: Message) -> None:
        """What the client is sent."""
        sent.append(message)

    scope = {"type": "http", "method": "POST", "path": "/v1/predict", "headers": headers or [], "client": (client, 1)}
    await admission({**scope, "state": {"record": RequestRecord("one", "POST")}}, receive, send)
    if not sent:
        return 0, {}, None
    return sent[0]["status"], dict(sent[0]["headers"]), json.loads(sent[1]["body"])


def run(scenario: Callable[[], Any]) -> None:
    """Run a scenario, for a minute at most."""

    async def bounded() -> None:
        """As far as the limits let it."""
        async with asyncio.timeout(60):
            await scenario()

    asyncio.run(bounded())


def test_a_body_in_pieces_arrives_whole() -> None:
    """However a client chops it."""

    async def scenario() -> None:
        """What happens, in the loop."""
        endpoint = Endpoint()
        pieces = [{**PART, "body": bytes([byte])} for byte in b"hello"]
        assert (await ask(Admission(endpoint, limits()), [*pieces, LAST]))[0] == 200
        assert endpoint.bodies == [b"hello"]

    run(scenario)


def test_a_body_over_the_limit_is_refused_declared_or_not() -> None:
    """At the limit it is read, beyond it nobody behind sees it."""

    async def scenario() -> None:
        """What happens, in the loop."""
        endpoint = Endpoint()
        admission = Admission(endpoint, limits())
        assert (await ask(admission, [PART] * 10 + [LAST]))[0] == 200
        status, _, document = await ask(admission, [PART] * 11 + [LAST])
        assert (status, document["code"]) == (413, "body_too_large")
        status, _, document = await ask(admission, [LAST], [(b"content-length", b"1001")])
        assert (status, document["code"]) == (413, "body_too_large")
        assert len(endpoint.bodies) == 1

    run(scenario)


def test_a_body_that_does_not_come_is_not_waited_for() -> None:
    """408, and the connection is closed; others are served meanwhile."""

    async def scenario() -> None:
        """What happens, in the loop."""
        admission = Admission(Endpoint(), limits(body_s=0.05, in_flight=1))
        slow = asyncio.ensure_future(ask(admission, [PART]))
        await asyncio.sleep(0)
        assert (await ask(admission, [LAST]))[0] == 200
        status, headers, document = await slow
        assert (status, document["code"], headers[b"connection"]) == (408, "slow_body", b"close")

    run(scenario)


def test_a_client_that_goes_away_gets_nothing_and_leaves_nothing() -> None:
    """What was held of it is held no more."""

    async def scenario() -> None:
        """What happens, in the loop."""
        admission = Admission(Endpoint(), limits(held_bytes=150))
        for _ in range(5):
            assert (await ask(admission, [PART, GONE]))[0] == 0
        assert (await ask(admission, [PART, LAST]))[0] == 200

    run(scenario)


def test_more_than_fits_is_refused_at_once_with_a_moment_to_wait() -> None:
    """The third of two; and when they are done there is room again."""

    async def scenario() -> None:
        """What happens, in the loop."""
        endpoint = Endpoint()
        admission = Admission(endpoint, limits())
        endpoint.release.clear()
        first, second = (asyncio.ensure_future(ask(admission, [LAST])) for _ in range(2))
        await asyncio.sleep(0.01)
        status, headers, document = await ask(admission, [LAST])
        assert (status, document["code"], headers[b"retry-after"]) == (503, "overloaded", b"1")
        endpoint.release.set()
        assert [(await first)[0], (await second)[0], (await ask(admission, [LAST]))[0]] == [200, 200, 200]

    run(scenario)


def test_one_caller_has_its_share_and_others_have_theirs() -> None:
    """By key where there is one, else by address."""

    async def scenario() -> None:
        """What happens, in the loop."""
        endpoint = Endpoint()
        admission = Admission(endpoint, limits(in_flight=9, in_flight_per_caller=1))
        endpoint.release.clear()
        key = [(b"authorization", b"Bearer one")]
        running = [
            asyncio.ensure_future(ask(admission, [LAST])),
            asyncio.ensure_future(ask(admission, [LAST], client="10.0.0.2")),
            asyncio.ensure_future(ask(admission, [LAST], key)),
        ]
        await asyncio.sleep(0.01)
        for headers in ([], key):
            status, answered, document = await ask(admission, [LAST], headers)
            assert (status, document["code"], answered[b"retry-after"]) == (429, "too_many_requests", b"1")
        endpoint.release.set()
        assert [(await task)[0] for task in running] == [200, 200, 200]
        assert (await ask(admission, [LAST]))[0] == 200

    run(scenario)


def test_bytes_of_all_requests_together_are_bounded() -> None:
    """Many bodies within their own limits are still not all held."""

    async def scenario() -> None:
        """What happens, in the loop."""
        endpoint = Endpoint()
        admission = Admission(endpoint, limits(held_bytes=1000, in_flight=9))
        endpoint.release.clear()
        running = asyncio.ensure_future(ask(admission, [PART] * 8 + [LAST]))
        await asyncio.sleep(0.01)
        assert (await ask(admission, [PART] * 8 + [LAST]))[0] == 503
        endpoint.release.set()
        assert (await running)[0] == 200
        assert (await ask(admission, [PART] * 8 + [LAST]))[0] == 200

    run(scenario)


def test_a_failure_behind_it_leaves_room() -> None:
    """Counts go down whatever happens."""

    async def broken(scope: Scope, receive: Receive, send: Send) -> None:
        """A client that is gone."""
        raise RuntimeError

    async def scenario() -> None:
        """What happens, in the loop."""
        admission = Admission(broken, limits(in_flight=1, in_flight_per_caller=1, held_bytes=150))
        for _ in range(3):
            try:
                await ask(admission, [PART, LAST])
            except RuntimeError:
                continue
            raise AssertionError("it was answered")

    run(scenario)
