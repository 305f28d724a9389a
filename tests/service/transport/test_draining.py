"""A server that goes on for a while after SIGTERM, and asks its clients to leave."""

import signal

import anyio
import pytest
import uvicorn

from service.transport.draining import DrainingServer


class Drained:
    """Who is told of the end."""

    times = 0

    def __call__(self) -> None:
        """The end has come."""
        self.times += 1


def server(drain_s: float, told: Drained) -> DrainingServer:
    """A server that does not run."""
    return DrainingServer(uvicorn.Config("nobody:app", log_config=None), drain_s, told)


def ticked(found: DrainingServer) -> bool:
    """Whether it closes at its next tick."""

    async def tick() -> bool:
        """One tick, in a loop."""
        return await found.on_tick(0)

    return anyio.run(tick)


def test_after_sigterm_it_serves_on_and_asks_clients_to_leave() -> None:
    """Whoever is told is told at once; from then on every answer closes its connection."""
    told = Drained()
    found = server(3600.0, told)
    found.handle_exit(signal.SIGTERM, None)
    assert told.times == 1
    assert (b"connection", b"close") in found.server_state.default_headers
    assert not ticked(found)
    assert (b"connection", b"close") in found.server_state.default_headers  # uvicorn makes them anew


def test_it_closes_when_that_time_is_over() -> None:
    """No time at all: at the next tick."""
    found = server(0.0, Drained())
    assert not ticked(found)
    found.handle_exit(signal.SIGTERM, None)
    assert ticked(found)


@pytest.mark.parametrize("signals", [[signal.SIGTERM, signal.SIGTERM], [signal.SIGINT]], ids=["twice", "Ctrl-C"])
def test_an_impatient_end_does_not_wait(signals: list[signal.Signals]) -> None:
    """A second SIGTERM, or a person at the keyboard."""
    found = server(3600.0, Drained())
    for number in signals:
        found.handle_exit(number, None)
    assert ticked(found)
