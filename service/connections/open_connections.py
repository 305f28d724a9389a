"""Open connections: bounded in number. If there is no room, an idle one of the caller with the most makes room.

A caller that holds all connections busy loses one to a caller that holds fewer, so that health checks get in.
"""

import sys
from collections import Counter
from typing import Final, Protocol

if sys.platform != "win32":
    import resource

OTHER_DESCRIPTORS: Final = 128  # for files, threads and the registry


class OpenConnection(Protocol):
    """A connection among others.

    Attributes:
        caller: address of the client, see ``transport.callers``.
    """

    caller: str

    def is_idle(self) -> bool:
        """Return True if no request is on its way, so that to close it loses none."""
        ...

    def is_busy(self) -> bool:
        """Return True if the service works on its request. Otherwise it waits for its client."""
        ...

    def waited_s(self) -> float:
        """Return the time for which it has waited for its client, in s."""
        ...

    def make_room(self) -> None:
        """End the connection at once."""
        ...

    def turn_away(self) -> None:
        """Refuse the connection: there is no room."""
        ...


def raise_descriptors(connections: int) -> None:
    """Raise the limit of file descriptors of this process for a number of connections, as far as the system allows."""
    if sys.platform != "win32":
        soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
        wanted = connections + OTHER_DESCRIPTORS
        if soft != resource.RLIM_INFINITY and soft < wanted:
            most = wanted if hard == resource.RLIM_INFINITY else min(wanted, hard)
            resource.setrlimit(resource.RLIMIT_NOFILE, (most, hard))


def affordable(connections: int) -> int:
    """Return the number of connections for which this process has file descriptors, up to the wanted number."""
    if sys.platform == "win32":
        return connections
    soft, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    return connections if soft == resource.RLIM_INFINITY else min(connections, max(1, soft - OTHER_DESCRIPTORS))


class OpenConnections:
    """The open connections of a service, as many as it may have and can afford."""

    def __init__(self, limit: int) -> None:
        self._limit = affordable(limit)
        self._open: dict[OpenConnection, None] = {}

    def __len__(self) -> int:
        return len(self._open)

    def enter(self, newcomer: OpenConnection) -> None:
        """Add a new connection. If there is no room, end another one, or turn the new one away."""
        if len(self._open) >= self._limit:
            leaver = self._leaver(newcomer)
            if leaver is None:
                newcomer.turn_away()
                return
            del self._open[leaver]
            leaver.make_room()
        self._open[newcomer] = None

    def leave(self, connection: OpenConnection) -> None:
        """Remove a connection that is lost."""
        self._open.pop(connection, None)

    def _leaver(self, newcomer: OpenConnection) -> OpenConnection | None:
        """Return the connection that makes room: an idle one, or one of a caller that holds more than the newcomer."""
        held = Counter(connection.caller for connection in self._open)
        idle = [connection for connection in self._open if connection.is_idle()]
        if idle:
            return max(idle, key=lambda connection: (held[connection.caller], connection.waited_s()))
        waiting = [
            connection
            for connection in self._open
            if not connection.is_busy() and held[connection.caller] > held[newcomer.caller] + 1
        ]
        return max(waiting, key=lambda connection: (held[connection.caller], connection.waited_s()), default=None)
