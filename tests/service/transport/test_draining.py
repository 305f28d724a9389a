"""The server keeps serving for some time after SIGTERM, and asks its clients to leave."""

import signal
from collections.abc import Callable

import anyio
import pytest
import uvicorn

from service.transport.draining import DrainingServer


class Drained:
    """A callback that counts its calls."""

    times = 0

    def __call__(self) -> None:
        """Count one."""
        self.times += 1


def server(drain_s: float, drained: Drained, ending: Callable[[float], None] = lambda _: None) -> DrainingServer:
    """Return a server that does not run."""
    config = uvicorn.Config("absent:app", log_config=None, timeout_graceful_shutdown=20)
    return DrainingServer(config, drain_s, drained, ending)


def ticked(found: DrainingServer) -> bool:
    """Return True if the server closes at its next tick."""

    async def tick() -> bool:
        """Run one tick in an event loop."""
        return await found.on_tick(0)

    return anyio.run(tick)


def test_after_sigterm_the_server_keeps_serving_and_asks_clients_to_leave() -> None:
    """The callback is called at once, and every later answer closes its connection."""
    drained = Drained()
    found = server(3600.0, drained)
    found.handle_exit(signal.SIGTERM, None)
    assert drained.times == 1
    assert (b"connection", b"close") in found.server_state.default_headers
    assert not ticked(found)
    assert (b"connection", b"close") in found.server_state.default_headers  # uvicorn makes these headers again


def test_the_server_closes_after_the_drain_time() -> None:
    """With a drain time of 0 the server closes at the next tick after SIGTERM."""
    found = server(0.0, Drained())
    assert not ticked(found)
    found.handle_exit(signal.SIGTERM, None)
    assert ticked(found)


@pytest.mark.parametrize("signals", [[signal.SIGTERM, signal.SIGTERM], [signal.SIGINT]], ids=["twice", "Ctrl-C"])
def test_a_second_signal_skips_the_drain_time(signals: list[signal.Signals]) -> None:
    """A second SIGTERM, or Ctrl-C, closes the server at the next tick."""
    found = server(3600.0, Drained())
    for number in signals:
        found.handle_exit(number, None)
    assert ticked(found)


def test_each_signal_begins_the_end_with_the_time_that_is_left() -> None:
    """After SIGTERM the server has the drain time and the time for running requests, after a second signal less."""
    limits: list[float] = []
    found = server(10.0, Drained(), limits.append)
    found.handle_exit(signal.SIGTERM, None)
    found.handle_exit(signal.SIGTERM, None)
    found.handle_exit(signal.SIGINT, None)
    assert limits == [30.0, 20.0, 20.0]
