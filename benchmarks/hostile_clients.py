"""Hostile, slow and vanishing clients: raw sockets against the instances until they are told to stop.

The corpus of tests/attacks/http is sent file by file. Some connections send one byte a second, some none. Others are
reset in the middle of a request, or before the answer is read. The outcomes are counted. An instance that is being
restarted refuses connections and leaves some requests unanswered. A status of 500 or more is never allowed.
"""

import itertools
import random
import socket
import struct
import threading
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path

from benchmarks.http_load import PUSH, ROOT

CORPUS = ROOT / "tests" / "attacks" / "http"
HEAD = b"POST /v1/predict HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\n"
REQUEST = HEAD + b"Content-Length: %d\r\n\r\n" % len(PUSH) + PUSH
ATTACK_EVERY_S = 0.25
VANISH_EVERY_S = 0.5
HELD_CONNECTIONS = 8
"""Number of slow connections, and of silent ones, that are open at any time."""
TIMEOUT_S = 15.0
RESET = struct.pack("ii", 1, 0)


class HostileClients:
    """Hostile clients in threads that end on a stop event. ``outcomes`` counts the answers."""

    def __init__(self, ports: Sequence[int], stop: threading.Event) -> None:
        self.outcomes: Counter[str] = Counter()
        self._ports = ports
        self._stop = stop
        self._random = random.Random(0)  # noqa: S311  # chooses where to cut a request, not a secret

    def tasks(self) -> list[Callable[[], None]]:
        """Return the tasks, each for a thread of its own."""
        return [self.attack, self.vanish, lambda: self.hold("slow", 1), lambda: self.hold("silent", 0)]

    def attack(self) -> None:
        """Send the corpus again and again, to each instance in turn."""
        files = sorted(CORPUS.glob("*.http"))
        for path, port in itertools.cycle(itertools.product(files, self._ports)):
            if self._stop.wait(ATTACK_EVERY_S):
                return
            outcome = _answer_to(path, port)
            self.outcomes[f"attack {outcome}"] += 1
            if outcome.isdigit() and not path.name.startswith(outcome):
                self.outcomes[f"unexpected {outcome} to {path.stem}"] += 1

    def vanish(self) -> None:
        """Close or reset connections in the middle of a request, or before its answer."""
        for port in itertools.cycle(self._ports):
            if self._stop.wait(VANISH_EVERY_S):
                return
            with suppress(OSError), socket.create_connection(("127.0.0.1", port), TIMEOUT_S) as connection:
                if self._random.random() < 0.5:
                    connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, RESET)
                connection.sendall(REQUEST[: self._random.randint(1, len(REQUEST))])
                self.outcomes["vanished mid-request"] += 1

    def hold(self, kind: str, bytes_per_s: int) -> None:
        """Keep connections open until the server closes them, then open others."""
        held, ports = list[_HeldConnection](), itertools.cycle(self._ports)
        while not self._stop.wait(1.0):
            for connection in list(held):
                outcome = connection.send_more(bytes_per_s)
                if outcome is not None:
                    self.outcomes[f"{kind} {outcome}"] += 1
                    held.remove(connection)
            for port in itertools.islice(ports, HELD_CONNECTIONS - len(held)):
                with suppress(OSError):
                    held.append(_HeldConnection(port))
        for connection in held:
            connection.close()


class _HeldConnection:
    """A connection that sends its request slowly, or not at all."""

    def __init__(self, port: int) -> None:
        self._connection = socket.create_connection(("127.0.0.1", port), TIMEOUT_S)
        self._connection.setblocking(False)
        self._sent = 0

    def send_more(self, count: int) -> str | None:
        """Send this many bytes more. Return the outcome if the connection has ended, else None."""
        try:
            received = self._connection.recv(4096)
        except BlockingIOError:
            with suppress(OSError):
                self._sent += self._connection.send(REQUEST[self._sent : self._sent + count])
            return None
        except OSError:
            received = b""
        self.close()
        return _status(received)

    def close(self) -> None:
        """Close the connection."""
        self._connection.close()


def _answer_to(path: Path, port: int) -> str:
    """Return the status that a file of the corpus gets, or ``refused`` or ``unanswered``."""
    try:
        connection = socket.create_connection(("127.0.0.1", port), TIMEOUT_S)
    except OSError:
        return "refused"
    with connection:
        with suppress(OSError):  # it may have answered before all was sent
            connection.sendall(path.read_bytes())
        try:
            return _status(connection.recv(4096))
        except OSError:
            return "unanswered"


def _status(received: bytes) -> str:
    """Return the status in the first bytes of an answer, or ``unanswered``."""
    return received.split(b" ", 2)[1].decode("latin-1") if received.startswith(b"HTTP/1.1 ") else "unanswered"
