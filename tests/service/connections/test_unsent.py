"""Answers have to leave in time, and their bytes are bounded in sum."""

import asyncio
from collections.abc import Awaitable, Callable

from starlette.responses import PlainTextResponse

from service.connections.unsent import LEAST_BYTES_PER_S, UnsentAnswers
from tests.fake_connection import FakeConnection, listener_of

LIMIT_S = 0.2


class FakeSender:
    """A connection with a number of unsent bytes, which a test sets."""

    def __init__(self, caller: str, unsent: int) -> None:
        self.caller = caller
        self.unsent = unsent
        self.reasons: list[str] = []

    def unsent_bytes(self) -> int:
        """Return the number that the test set."""
        return self.unsent

    def cut_off(self, reason: str) -> None:
        """Note the reason."""
        self.reasons.append(reason)


def run(scenario: Callable[[], Awaitable[None]]) -> None:
    """Run a scenario for at most a minute."""

    async def bounded() -> None:
        """Run it with a time limit."""
        async with asyncio.timeout(60):
            await scenario()

    asyncio.run(bounded())


def test_a_client_that_takes_too_little_is_cut_off() -> None:
    """In each window some bytes have to leave. One that takes enough is watched on, and one that took all is not."""

    async def scenario() -> None:
        """Watch three clients."""
        answers = UnsentAnswers(LIMIT_S, 1 << 30)
        deaf, slow, done = (FakeSender(name, 1 << 20) for name in ("deaf", "slow", "done"))
        for sender in (deaf, slow, done):
            answers.add(sender)
        answers.remove(done)
        while not deaf.reasons:
            slow.unsent -= LEAST_BYTES_PER_S
            await asyncio.sleep(LIMIT_S / 20.0)
        assert (deaf.reasons, slow.reasons, done.reasons) == (["slow_reader"], [], [])
        assert answers.total == slow.unsent
        while not slow.reasons:
            await asyncio.sleep(LIMIT_S / 20.0)
        assert answers.total == 0

    run(scenario)


def test_the_caller_with_the_most_loses_its_oldest_connection() -> None:
    """The bytes of all are bounded, and a caller with few keeps its own. A single large answer is never too much."""

    async def scenario() -> None:
        """Add answers beyond the limit."""
        answers = UnsentAnswers(3600.0, 1000)
        alone = FakeSender("large", 2000)
        answers.add(alone)
        assert not alone.reasons
        answers.remove(alone)
        modest = FakeSender("modest", 300)
        greedy = [FakeSender("greedy", 200) for _ in range(4)]
        for sender in (modest, *greedy):
            answers.add(sender)
        assert not modest.reasons
        assert [sender.reasons for sender in greedy] == [["unsent_answers"], [], [], []]
        assert answers.total == 900

    run(scenario)


def test_no_request_is_begun_while_an_answer_waits() -> None:
    """A client that does not read has one request at a time, and bytes in bounds."""

    async def scenario() -> None:
        """Send two requests while the first answer does not leave."""
        listener = listener_of(write_s=LIMIT_S)
        connection = FakeConnection(PlainTextResponse("fine"), None, listener=listener)
        request = b"GET / HTTP/1.1\r\nhost: a\r\n\r\n"
        connection.transport.unsent = 70_000
        connection.receive(request)
        await connection.answers(1)
        connection.protocol.pause_writing()
        connection.receive(request)
        await asyncio.sleep(0.01)
        assert connection.transport.sent_answers() == 1
        assert not connection.protocol.is_idle()
        connection.transport.unsent = 0
        connection.protocol.resume_writing()
        await connection.answers(2)
        assert connection.transport.sent_answers() == 2
        connection.transport.unsent = 70_000
        connection.protocol.pause_writing()
        while not connection.transport.closed:
            await asyncio.sleep(LIMIT_S / 20.0)

    run(scenario)
