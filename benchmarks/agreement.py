"""Which version each instance serves, how soon a promoted one is there, and how long instances disagree."""

import http.client
import json
import socket
from collections.abc import Sequence
from dataclasses import dataclass, field

from benchmarks.asking import PUSH

PATIENCE_S = 30.0
KNOCK_S = 0.5  # the kernel takes a connection at once, unless the instance is just closing its doors
HEADERS = {"Content-Type": "application/json"}
Versions = Sequence[int | None]
"""What each instance answered with; None: it did not answer."""


class Witness:
    """One client of an instance, on a connection that it keeps as long as it may."""

    def __init__(self, port: int) -> None:
        self._address = ("127.0.0.1", port)
        self._connection = http.client.HTTPConnection(*self._address)

    def ready(self) -> int | None:
        """The status of /readyz; None: nobody answers."""
        return self._ask("GET", "/readyz")[0]

    def version(self) -> int | None:
        """The version that answers a prediction; None: none does."""
        status, body = self._ask("POST", "/v1/predict", PUSH)
        return int(json.loads(body)["model"]["version"]) if status == 200 else None

    def close(self) -> None:
        """Leave."""
        self._connection.close()

    def _ask(self, method: str, path: str, body: bytes | None = None) -> tuple[int | None, bytes]:
        try:
            if self._connection.sock is None:
                self._connection.sock = socket.create_connection(self._address, KNOCK_S)
                self._connection.sock.settimeout(PATIENCE_S)
            self._connection.request(method, path, body, HEADERS)
            response = self._connection.getresponse()
            return response.status, response.read()
        except (OSError, http.client.HTTPException):
            self._connection.close()  # the next question opens it again
            return None, b""


@dataclass
class Agreement:
    """What was seen of promotes and versions, in the order of time.

    An instance that does not answer disagrees with nobody, and a promote that happened while it was away is not counted
    against it: it comes back with what the registry says then.
    """

    reached_s: list[float] = field(default_factory=list)
    """From each promote to the first answer with it, instance by instance."""
    apart_s: list[float] = field(default_factory=list)
    """How long each disagreement lasted."""
    _promoted: int | None = None
    _promoted_at_s: float = 0.0
    _waiting: set[int] = field(default_factory=set)
    _apart_since_s: float | None = None
    _last_look_s: float = 0.0

    def promote(self, at_s: float, version: int, instances: int) -> None:
        """A version became the champion."""
        self._promoted, self._promoted_at_s = version, at_s
        self._waiting = set(range(instances))

    def see(self, at_s: float, versions: Versions) -> None:
        """What the instances served at an instant."""
        for place in sorted(self._waiting):
            if versions[place] is None:
                self._waiting.discard(place)
            elif versions[place] == self._promoted:
                self._waiting.discard(place)
                self.reached_s.append(at_s - self._promoted_at_s)
        apart = len({version for version in versions if version is not None}) > 1
        if apart and self._apart_since_s is None:
            self._apart_since_s = at_s
        elif not apart and self._apart_since_s is not None:
            ended_s = self._last_look_s if None in versions else at_s
            self.apart_s.append(ended_s - self._apart_since_s)
            self._apart_since_s = None
        self._last_look_s = at_s

    @property
    def settled(self) -> bool:
        """Whether every instance that answers serves what was promoted last."""
        return not self._waiting and self._apart_since_s is None

    def take(self) -> dict[str, list[float]]:
        """What was measured since the last time."""
        taken = {"reached_s": self.reached_s, "apart_s": self.apart_s}
        self.reached_s, self.apart_s = [], []
        return taken
