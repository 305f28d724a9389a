"""Answers that have not left: they have to leave in time, and their bytes are bounded in sum.

A client that sends requests and does not read its answers would hold their memory for ever. Its connection is cut off.
"""

import asyncio
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final, Protocol

LEAST_BYTES_PER_S: Final = 4096
_CHECK_S: Final = 1.0


class PairedWrites:
    """A transport that joins two writes: it holds the first until the second, or until the end of the iteration.

    To close it asks its connection, which knows whether its client is still sending.
    """

    def __init__(
        self, transport: asyncio.Transport, loop: asyncio.AbstractEventLoop, finish: Callable[[], None]
    ) -> None:
        self._transport = transport
        self._loop = loop
        self._finish = finish
        self._held = b""

    def __getattr__(self, name: str) -> Any:
        return getattr(self._transport, name)

    def write(self, data: bytes) -> None:
        """Send together with the held bytes, or hold these until the next write."""
        if self._held:
            held, self._held = self._held, b""
            self._transport.writelines((held, data))
        else:
            self._held = data
            self._loop.call_soon(self._send_held)

    def write_whole(self, data: bytes) -> None:
        """Send a complete answer, after the held bytes."""
        self._send_held()
        self._transport.write(data)

    def close(self) -> None:
        """Ask the connection to end."""
        self._finish()

    def end(self) -> None:
        """Send the held bytes, then close."""
        self._send_held()
        self._transport.close()

    def end_sending(self) -> None:
        """Send the held bytes and an end, and keep receiving."""
        self._send_held()
        if not self._transport.is_closing():
            self._transport.write_eof()

    def _send_held(self) -> None:
        held, self._held = self._held, b""
        if held and not self._transport.is_closing():
            self._transport.write(held)


class Sender(Protocol):
    """A connection whose answers have not left.

    Attributes:
        caller: address of the client, see ``transport.callers``.
    """

    caller: str

    def unsent_bytes(self) -> int:
        """Return the number of bytes that its client has not taken."""
        ...

    def cut_off(self, reason: str) -> None:
        """End the connection at once, and count why."""
        ...


@dataclass(slots=True)
class _Window:
    """A window of time in which bytes have to leave."""

    began_s: float
    bytes: int


class UnsentAnswers:
    """The answers of all connections that have not left."""

    def __init__(self, limit_s: float, limit_bytes: int) -> None:
        self._limit_s = limit_s
        self._limit_bytes = limit_bytes
        self._waiting: dict[Sender, _Window] = {}
        self._armed = False

    @property
    def total(self) -> int:
        """Return the bytes of all answers that have not left."""
        return sum(sender.unsent_bytes() for sender in self._waiting)

    def add(self, sender: Sender) -> None:
        """Watch a connection until its answers have left, and cut connections off while all hold too much."""
        loop = asyncio.get_running_loop()
        self._waiting[sender] = _Window(loop.time(), sender.unsent_bytes())
        if not self._armed:
            self._arm(loop)
        while len(self._waiting) > 1 and self.total > self._limit_bytes:
            self._cut_off(self._greediest(), "unsent_answers")

    def remove(self, sender: Sender) -> None:
        """Forget a connection: its answers have left, or it is lost."""
        self._waiting.pop(sender, None)

    def _greediest(self) -> Sender:
        """Return the connection that waits longest of the caller with the most bytes."""
        held: Counter[str] = Counter()
        for sender in self._waiting:
            held[sender.caller] += sender.unsent_bytes()
        caller, _ = held.most_common(1)[0]
        return next(sender for sender in self._waiting if sender.caller == caller)

    def _cut_off(self, sender: Sender, reason: str) -> None:
        self.remove(sender)
        sender.cut_off(reason)

    def _arm(self, loop: asyncio.AbstractEventLoop) -> None:
        self._armed = True
        loop.call_later(min(_CHECK_S, self._limit_s / 4.0), self._check, loop)

    def _check(self, loop: asyncio.AbstractEventLoop) -> None:
        """Cut off every client that took too few bytes in its window, and begin new windows for the others."""
        self._armed = False
        now_s = loop.time()
        for sender, window in [*self._waiting.items()]:
            if now_s - window.began_s < self._limit_s:
                continue
            unsent = sender.unsent_bytes()
            if window.bytes - unsent < LEAST_BYTES_PER_S * self._limit_s:
                self._cut_off(sender, "slow_reader")
            else:
                window.began_s, window.bytes = now_s, unsent
        if self._waiting:
            self._arm(loop)
