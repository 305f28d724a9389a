"""Listener: the limits and counts that its connections share, and the parts of uvicorn that each connection changes."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from uvicorn.protocols.http.flow_control import FlowControl
from uvicorn.protocols.http.httptools_impl import RequestResponseCycle
from uvicorn.server import ServerState

from service.connections.open_connections import OpenConnections
from service.connections.unsent import UnsentAnswers
from service.transport.shares import Shares


@dataclass(frozen=True)
class ConnectionLimits:
    """Limits of each connection, and of all of them.

    Attributes:
        head_s: longest time until a head is complete, and longest time to read on behind an early refusal, in s.
        idle_s: longest time between an answer and the next request, in s.
        write_s: time in which a part of a waiting answer has to leave, in s.
        connections: maximum number of connections.
        unsent_bytes: maximum bytes of all answers that have not left.
    """

    head_s: float
    idle_s: float
    write_s: float
    connections: int
    unsent_bytes: int


class Listener:
    """Limits and counts of the connections of one listener, and the counter of refusals.

    Attributes:
        limits: limits of connections.
        held: bytes of requests in memory, by caller.
        refuse: counts a refusal that happens before there is a request by its code, and returns an id for its answer.
    """

    def __init__(self, limits: ConnectionLimits, held: Shares, refuse: Callable[[str], str]) -> None:
        self.limits = limits
        self.held = held
        self.refuse = refuse
        self.unsent = UnsentAnswers(limits.write_s, limits.unsent_bytes)
        self.open = OpenConnections(limits.connections)

    @property
    def count(self) -> int:
        """Return the number of open connections."""
        return len(self.open)

    @property
    def unsent_bytes(self) -> int:
        """Return the bytes of answers that their clients have not taken."""
        return self.unsent.total


class GatedFlow(FlowControl):
    """Flow control of uvicorn with a gate: while it is shut, no reader may resume reading."""

    is_shut = False

    def resume_reading(self) -> None:
        """Resume reading, unless the bytes of the next request wait already."""
        if not self.is_shut:
            super().resume_reading()


class Cycle(RequestResponseCycle):
    """A request and its answer. An answer that comes before the whole body is the last one of its connection.

    Attributes:
        server_state: has the headers of every answer at this time. The server may have begun to end since the request.
    """

    server_state: ServerState

    async def send(self, message: Any) -> None:
        """Send a part of the answer."""
        if not self.response_started:
            self.default_headers = self.server_state.default_headers
            self.keep_alive = self.keep_alive and not self.more_body
        await super().send(message)
