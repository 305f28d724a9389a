"""Admission bounds bodies, slow clients and concurrent requests. The tests call the ring as a server does."""

import asyncio
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from starlette.types import Message, Receive, Scope, Send

from service.observability.records import RequestRecord
from service.transport.admission import HEALTH, Admission, AdmissionLimits
from service.transport.callers import Callers
from service.transport.keys import Keys
from service.transport.loop_turns import LoopTurns

ANYONE = Callers(Keys(None))
PART: Message = {"type": "http.request", "body": b"x" * 100, "more_body": True}
LAST: Message = {"type": "http.request", "body": b"", "more_body": False}
GONE: Message = {"type": "http.disconnect"}


def limits(**changes: Any) -> AdmissionLimits:
    """Return small limits, with these changes."""
    usual = {"body_bytes": 1000, "body_s": 5.0, "in_flight": 2, "in_flight_per_caller": 0, "held_bytes": 10_000}
    return AdmissionLimits(**(usual | changes))


class SlowApp:
    """An application that keeps the bodies of its requests, and answers once it is released."""

    def __init__(self) -> None:
        self.bodies: list[bytes] = []
        self.release = asyncio.Event()
        self.release.set()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer 200."""
        message = await receive()
        assert not message["more_body"]
        self.bodies.append(message["body"])
        await self.release.wait()
        await send({"type": "http.response.start", "status": 200, "headers": []})
        await send({"type": "http.response.body", "body": b"{}"})


async def send_messages(
    admission: Admission,
    messages: list[Message],
    headers: list[tuple[bytes, bytes]] | None = None,
    client: str = "10.0.0.1",
    path: str = "/v1/predict",
) -> tuple[int, dict[bytes, bytes], Any]:
    """Send these messages, and no more. Return status, headers and document of the answer, or status 0 without one."""
    sent: list[Message] = []
    waiting = iter(messages)

    async def receive() -> Message:
        """Return the next message of the client."""
        for message in waiting:
            return message
        await asyncio.Event().wait()
        raise AssertionError

    async def send(message: Message) -> None:
        """Keep a message to the client."""
        sent.append(message)

    scope = {"type": "http", "method": "POST", "path": path, "headers": headers or [], "client": (client, 1)}
    await admission({**scope, "state": {"record": RequestRecord("one", "POST")}}, receive, send)
    if not sent:
        return 0, {}, None
    return sent[0]["status"], dict(sent[0]["headers"]), json.loads(sent[1]["body"])


def run(scenario: Callable[[], Any]) -> None:
    """Run a scenario for at most a minute."""

    async def bounded() -> None:
        """Run it with a time limit."""
        async with asyncio.timeout(60):
            await scenario()

    asyncio.run(bounded())


def test_a_body_in_pieces_arrives_complete() -> None:
    """The application gets the body in one piece, for any pieces that the client sends."""

    async def scenario() -> None:
        """Run the scenario in an event loop."""
        app = SlowApp()
        pieces = [{**PART, "body": bytes([byte])} for byte in b"hello"]
        assert (await send_messages(Admission(app, limits(), ANYONE), [*pieces, LAST]))[0] == 200
        assert app.bodies == [b"hello"]

    run(scenario)


def test_a_body_over_the_limit_is_refused() -> None:
    """A body at the limit is read. A larger one is refused with 413, by its declared length or by its bytes."""

    async def scenario() -> None:
        """Run the scenario in an event loop."""
        app = SlowApp()
        admission = Admission(app, limits(), ANYONE)
        assert (await send_messages(admission, [PART] * 10 + [LAST]))[0] == 200
        status, _, document = await send_messages(admission, [PART] * 11 + [LAST])
        assert (status, document["code"]) == (413, "body_too_large")
        status, _, document = await send_messages(admission, [LAST], [(b"content-length", b"1001")])
        assert (status, document["code"]) == (413, "body_too_large")
        assert len(app.bodies) == 1

    run(scenario)


def test_a_late_body_is_refused() -> None:
    """A late body is a 408 that closes the connection, and does not delay other requests."""

    async def scenario() -> None:
        """Run the scenario in an event loop."""
        admission = Admission(SlowApp(), limits(body_s=0.05, in_flight=1), ANYONE)
        slow = asyncio.ensure_future(send_messages(admission, [PART]))
        await asyncio.sleep(0)
        assert (await send_messages(admission, [LAST]))[0] == 200
        status, headers, document = await slow
        assert (status, document["code"], headers[b"connection"]) == (408, "slow_body", b"close")

    run(scenario)


def test_a_client_that_disconnects_releases_its_bytes() -> None:
    """The bytes of a client that disconnects during its body no longer count as held."""

    async def scenario() -> None:
        """Run the scenario in an event loop."""
        admission = Admission(SlowApp(), limits(held_bytes=150), ANYONE)
        for _ in range(5):
            assert (await send_messages(admission, [PART, GONE]))[0] == 0
        assert (await send_messages(admission, [PART, LAST]))[0] == 200

    run(scenario)


def test_a_request_over_the_limit_in_flight_is_refused() -> None:
    """A third request beside two is a 503 with Retry-After, and is accepted once they are done."""

    async def scenario() -> None:
        """Run the scenario in an event loop."""
        app = SlowApp()
        admission = Admission(app, limits(), ANYONE)
        app.release.clear()
        first, second = (asyncio.ensure_future(send_messages(admission, [LAST])) for _ in range(2))
        await asyncio.sleep(0.01)
        status, headers, document = await send_messages(admission, [LAST])
        assert (status, document["code"], headers[b"retry-after"]) == (503, "overloaded", b"1")
        app.release.set()
        assert [(await first)[0], (await second)[0], (await send_messages(admission, [LAST]))[0]] == [200, 200, 200]

    run(scenario)


def test_requests_are_limited_per_caller() -> None:
    """A caller over its limit gets a 429, and other callers are served. A header makes no other caller of it."""

    async def scenario() -> None:
        """Run the scenario in an event loop."""
        app = SlowApp()
        admission = Admission(app, limits(in_flight=9, in_flight_per_caller=1), ANYONE)
        app.release.clear()
        junk = [(b"authorization", b"Bearer one"), (b"x-forwarded-for", b"10.9.9.9")]
        running = [
            asyncio.ensure_future(send_messages(admission, [LAST])),
            asyncio.ensure_future(send_messages(admission, [LAST], client="10.0.0.2")),
        ]
        await asyncio.sleep(0.01)
        for headers in ([], junk):
            status, answered, document = await send_messages(admission, [LAST], headers)
            assert (status, document["code"], answered[b"retry-after"]) == (429, "too_many_requests", b"1")
        app.release.set()
        assert [(await task)[0] for task in running] == [200, 200]
        assert (await send_messages(admission, [LAST]))[0] == 200

    run(scenario)


def test_bytes_of_all_requests_together_are_bounded() -> None:
    """Bodies within their own limit are refused if all bodies together are over the limit."""

    async def scenario() -> None:
        """Run the scenario in an event loop."""
        app = SlowApp()
        admission = Admission(app, limits(held_bytes=1000, in_flight=9), ANYONE)
        app.release.clear()
        running = asyncio.ensure_future(send_messages(admission, [PART] * 6 + [LAST]))
        await asyncio.sleep(0.01)
        assert (await send_messages(admission, [PART] * 6 + [LAST]))[0] == 503
        app.release.set()
        assert (await running)[0] == 200
        assert (await send_messages(admission, [PART] * 6 + [LAST]))[0] == 200

    run(scenario)


def test_a_failed_request_is_no_longer_counted() -> None:
    """The counts go down also if the application raises an exception."""

    async def broken(scope: Scope, receive: Receive, send: Send) -> None:
        """Fail, as when a client disconnects."""
        raise RuntimeError

    async def scenario() -> None:
        """Run the scenario in an event loop."""
        admission = Admission(broken, limits(in_flight=1, in_flight_per_caller=1, held_bytes=150), ANYONE)
        for _ in range(3):
            try:
                await send_messages(admission, [PART, LAST])
            except RuntimeError:
                continue
            raise AssertionError("it was answered")

    run(scenario)


def test_a_request_is_in_flight_until_its_answer_begins_to_leave() -> None:
    """A client that does not read its answer keeps no other one from being served."""

    async def scenario() -> None:
        """Answer two requests whose clients do not read, with a limit of one request in flight."""
        admission = Admission(SlowApp(), limits(in_flight=1), ANYONE)
        heads: list[Message] = []

        async def deaf(message: Message) -> None:
            """Take the head of the answer, and no more."""
            heads.append(message)
            await asyncio.Event().wait()

        async def receive() -> Message:
            """Return an empty body."""
            return LAST

        scope = {"type": "http", "method": "POST", "path": "/v1/predict", "headers": [], "client": ("10.0.0.1", 1)}
        for _ in range(2):
            state = {"record": RequestRecord("one", "POST")}
            asyncio.get_running_loop().create_task(admission({**scope, "state": state}, receive, deaf))
            await asyncio.sleep(0.01)
            assert admission.in_flight == 0
        assert [message["status"] for message in heads] == [200, 200]

    run(scenario)


def test_one_caller_holds_no_more_than_its_share() -> None:
    """Bodies of one caller get a 503 at three quarters of the bytes, while another caller is served."""

    async def scenario() -> None:
        """Hold 700 of 1000 bytes for one caller."""
        app = SlowApp()
        admission = Admission(app, limits(held_bytes=1000, in_flight=9), ANYONE)
        app.release.clear()
        running = [asyncio.ensure_future(send_messages(admission, [PART] * 7 + [LAST]))]
        await asyncio.sleep(0.01)
        assert (await send_messages(admission, [PART, LAST]))[0] == 503
        running.append(asyncio.ensure_future(send_messages(admission, [PART, LAST], client="10.0.0.2")))
        await asyncio.sleep(0.01)
        app.release.set()
        assert [(await one)[0] for one in running] == [200, 200]
        assert admission.held_bytes == 0

    run(scenario)


def test_the_key_is_checked_before_the_body(tmp_path: Path) -> None:
    """A request without a key is refused by its head: no byte of its body is asked for."""

    async def scenario() -> None:
        """Send a head whose body never comes."""
        (tmp_path / "keys").write_text("")
        app = SlowApp()
        admission = Admission(app, limits(), Callers(Keys(tmp_path / "keys")))
        status, headers, document = await send_messages(admission, [], [(b"content-length", b"900")])
        assert (status, document["code"], headers[b"www-authenticate"]) == (401, "missing_key", b"Bearer")
        assert not app.bodies

    run(scenario)


@pytest.mark.parametrize("path", sorted(HEALTH))
def test_health_has_a_quota_of_its_own(path: str) -> None:
    """A route of health answers while requests and bytes are at their limits, and takes no large body."""

    async def scenario() -> None:
        """Ask for health without room for any request."""
        admission = Admission(SlowApp(), limits(in_flight=0, held_bytes=0), ANYONE)
        assert (await send_messages(admission, [LAST]))[0] == 503
        assert (await send_messages(admission, [LAST], path=path))[0] == 200
        assert (await send_messages(admission, [{**PART, "body": bytes(5000)}], path=path))[0] == 413
        assert (admission.in_flight, admission.held_bytes) == (0, 0)

    run(scenario)


def test_requests_that_come_at_once_are_passed_on_in_turns() -> None:
    """Each of many requests goes on in an iteration of its own once the time of one is used up. Health never waits."""

    async def scenario() -> None:
        """Send requests to an application that notes their order, and for health as the last."""
        order: list[str] = []

        async def app(scope: Scope, receive: Receive, send: Send) -> None:
            """Note the path, and answer."""
            order.append(scope["path"])
            await send({"type": "http.response.start", "status": 200, "headers": []})
            await send({"type": "http.response.body", "body": b"{}"})

        ring = Admission(app, limits(in_flight=20, in_flight_per_caller=20), ANYONE, LoopTurns(0.0))
        paths = [*(f"/v1/{number}" for number in range(9)), "/livez"]
        await asyncio.gather(*(send_messages(ring, [LAST], path=path) for path in paths))
        assert order == [paths[0], paths[-1], *paths[1:-1]]

    run(scenario)
