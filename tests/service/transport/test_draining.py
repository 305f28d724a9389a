"""The server keeps serving for some time after SIGTERM, and asks its clients to leave."""

import signal

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


def server(drain_s: float, drained: Drained) -> DrainingServer:
    """Return a server that does not run."""
    return DrainingServer(uvicorn.Config("absent:app", log_config=None), drain_s, drained)


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
