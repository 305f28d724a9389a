"""Clients that mean harm, are slow, or vanish: raw sockets against the instances, for as long as it takes.

The corpus of tests/attacks/http is sent file by file; some connections get a byte a second, some none at all; others
are torn off in the middle of a request, or before the answer is read. Counted is what came back. An instance that
is being restarted refuses, and leaves some without an answer; what may never come is a status of 500 or more.
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

from benchmarks.asking import PUSH, ROOT

CORPUS = ROOT / "tests" / "attacks" / "http"
HEAD = b"POST /v1/predict HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\n"
REQUEST = HEAD + b"Content-Length: %d\r\n\r\n" % len(PUSH) + PUSH
ATTACK_EVERY_S = 0.25
VANISH_EVERY_S = 0.5
HELD = 8
"""Slow connections, and as many silent ones, that are open at any time."""
PATIENCE_S = 15.0
RESET = struct.pack("ii", 1, 0)


class HostileClients:
    """Threads of hostile clients, which end when told; what they got is in ``outcomes``."""

    def __init__(self, ports: Sequence[int], stop: threading.Event) -> None:
        self.outcomes: Counter[str] = Counter()
        self._ports = ports
        self._stop = stop
        self._random = random.Random(0)  # noqa: S311  # chooses where to tear, not a secret

    def kinds(self) -> list[Callable[[], None]]:
        """What to run, each in a thread of its own."""
        return [self.attack, self.vanish, lambda: self.hold("slow", 1), lambda: self.hold("silent", 0)]

    def attack(self) -> None:
        """Send the corpus, over and over, to each instance in turn."""
        files = sorted(CORPUS.glob("*.http"))
        for path, port in itertools.cycle(itertools.product(files, self._ports)):
            if self._stop.wait(ATTACK_EVERY_S):
                return
            outcome = _answer_to(path, port)
            self.outcomes[f"attack {outcome}"] += 1
            if outcome.isdigit() and not path.name.startswith(outcome):
                self.outcomes[f"unexpected {outcome} to {path.stem}"] += 1

    def vanish(self) -> None:
        """Be gone in the middle of a request, or before its answer, in order or torn off."""
        for port in itertools.cycle(self._ports):
            if self._stop.wait(VANISH_EVERY_S):
                return
            with suppress(OSError), socket.create_connection(("127.0.0.1", port), PATIENCE_S) as connection:
                if self._random.random() < 0.5:
                    connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, RESET)
                connection.sendall(REQUEST[: self._random.randint(1, len(REQUEST))])
                self.outcomes["vanished mid-request"] += 1

    def hold(self, kind: str, bytes_per_s: int) -> None:
        """Keep connections open until they are closed from over there, then open others."""
        held, ports = list[_Held](), itertools.cycle(self._ports)
        while not self._stop.wait(1.0):
            for connection in list(held):
                outcome = connection.go_on(bytes_per_s)
                if outcome is not None:
                    self.outcomes[f"{kind} {outcome}"] += 1
                    held.remove(connection)
            for port in itertools.islice(ports, HELD - len(held)):
                with suppress(OSError):
                    held.append(_Held(port))
        for connection in held:
            connection.close()


class _Held:
    """A connection that is in no hurry."""

    def __init__(self, port: int) -> None:
        self._connection = socket.create_connection(("127.0.0.1", port), PATIENCE_S)
        self._connection.setblocking(False)
        self._sent = 0

    def go_on(self, count: int) -> str | None:
        """Send so many bytes more; how it ended, if it did."""
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
        """Leave."""
        self._connection.close()


def _answer_to(path: Path, port: int) -> str:
    """The status that a file of the corpus gets, or what came instead."""
    try:
        connection = socket.create_connection(("127.0.0.1", port), PATIENCE_S)
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
    """The status in the first bytes of an answer."""
    return received.split(b" ", 2)[1].decode("latin-1") if received.startswith(b"HTTP/1.1 ") else "unanswered"
