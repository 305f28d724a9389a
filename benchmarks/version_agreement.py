"""Version agreement between instances: time until a promoted version is served, and time that instances disagree."""

import http.client
import json
import socket
from collections.abc import Sequence
from dataclasses import dataclass, field

from benchmarks.http_load import PUSH

TIMEOUT_S = 30.0
CONNECT_TIMEOUT_S = 0.5  # the kernel accepts a connection at once, unless the instance is closing its sockets
HEADERS = {"Content-Type": "application/json"}
Versions = Sequence[int | None]
"""The version that each instance answered with; None if it did not answer."""


class VersionProbe:
    """A client of one instance that asks for its readiness and its version on a kept connection."""

    def __init__(self, port: int) -> None:
        self._address = ("127.0.0.1", port)
        self._connection = http.client.HTTPConnection(*self._address)

    def ready(self) -> int | None:
        """Return the status of /readyz, or None without an answer."""
        return self._ask("GET", "/readyz")[0]

    def version(self) -> int | None:
        """Return the version that answers a prediction, or None without a 200."""
        status, body = self._ask("POST", "/v1/predict", PUSH)
        return int(json.loads(body)["model"]["version"]) if status == 200 else None

    def close(self) -> None:
        """Close the connection."""
        self._connection.close()

    def _ask(self, method: str, path: str, body: bytes | None = None) -> tuple[int | None, bytes]:
        try:
            if self._connection.sock is None:
                self._connection.sock = socket.create_connection(self._address, CONNECT_TIMEOUT_S)
                self._connection.sock.settimeout(TIMEOUT_S)
            self._connection.request(method, path, body, HEADERS)
            response = self._connection.getresponse()
            return response.status, response.read()
        except (OSError, http.client.HTTPException):
            self._connection.close()  # the next request opens it again
            return None, b""


@dataclass
class Agreement:
    """Promotions and served versions, observed in the order of time.

    An instance that does not answer is not counted as a disagreement. Nor is a promotion during its absence, because it
    comes back with the champion that the registry has then.
    """

    reached_s: list[float] = field(default_factory=list)
    """Seconds from each promotion to an instance's first answer with it."""
    apart_s: list[float] = field(default_factory=list)
    """Seconds that each disagreement lasted."""
    _promoted: int | None = None
    _promoted_at_s: float = 0.0
    _waiting: set[int] = field(default_factory=set)
    _apart_since_s: float | None = None
    _observed_at_s: float = 0.0

    def promote(self, at_s: float, version: int, instances: int) -> None:
        """Note that a version became the champion."""
        self._promoted, self._promoted_at_s = version, at_s
        self._waiting = set(range(instances))

    def observe(self, at_s: float, versions: Versions) -> None:
        """Note the versions that the instances served at one instant."""
        for instance in sorted(self._waiting):
            if versions[instance] is None:
                self._waiting.discard(instance)
            elif versions[instance] == self._promoted:
                self._waiting.discard(instance)
                self.reached_s.append(at_s - self._promoted_at_s)
        apart = len({version for version in versions if version is not None}) > 1
        if apart and self._apart_since_s is None:
            self._apart_since_s = at_s
        elif not apart and self._apart_since_s is not None:
            ended_s = self._observed_at_s if None in versions else at_s
            self.apart_s.append(ended_s - self._apart_since_s)
            self._apart_since_s = None
        self._observed_at_s = at_s

    @property
    def settled(self) -> bool:
        """True if every instance that answers serves the version that was promoted last."""
        return not self._waiting and self._apart_since_s is None

    def take_times(self) -> dict[str, list[float]]:
        """Return the times measured since the last call, and forget them."""
        taken = {"reached_s": self.reached_s, "apart_s": self.apart_s}
        self.reached_s, self.apart_s = [], []
        return taken
