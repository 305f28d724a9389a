"""Two service processes over one registry: what reaches both, and what the death of one costs the other."""

import http.client
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import pytest

from service.registry.registry import Registry
from tests.running_service import PATIENCE_S, ROOT, free_port, wait_until

NAME = "push-indicator"
BODY = b'{"pusher": {"x": -0.075, "y": 0.0, "angle": 0.0}, "context": {"descriptor": "1a2b3c4a"}}'
JSON = {"Content-Type": "application/json"}


@dataclass
class Replica:
    """A service process on a port, started again after its death."""

    port: int
    registry: Registry
    log: Path
    process: subprocess.Popen[bytes]

    @classmethod
    def started(cls, registry: Registry, log: Path) -> "Replica":
        """The first process, which does not answer yet."""
        port = free_port()
        return cls(port, registry, log, _launched(port, registry, log))

    def start_again(self) -> None:
        """The next process on the same port."""
        self.process = _launched(self.port, self.registry, self.log)

    def kill(self) -> None:
        """SIGKILL, and wait until it is gone."""
        self.process.kill()
        self.process.wait()

    def readiness(self) -> int | None:
        """The status of /readyz; None: the connection is refused."""
        assert self.process.poll() is None or self.process.returncode < 0, self.log.read_text()
        try:
            return self._ask("GET", "/readyz", None)[0]
        except ConnectionError:
            return None

    def is_ready(self) -> bool:
        """Whether it says so."""
        return self.readiness() == 200

    def serves(self, version: int) -> bool:
        """Whether a prediction, which must be answered, comes from that version."""
        return self.version() == version

    def version(self) -> int:
        """The version that answers a prediction, which must be answered."""
        status, body = self._ask("POST", "/v1/predict", BODY)
        assert status == 200, body
        return int(json.loads(body)["model"]["version"])

    def _ask(self, method: str, path: str, body: bytes | None) -> tuple[int, bytes]:
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=PATIENCE_S)
        try:
            connection.request(method, path, body, JSON)
            response = connection.getresponse()
            return response.status, response.read()
        finally:
            connection.close()


def _launched(port: int, registry: Registry, log: Path) -> subprocess.Popen[bytes]:
    environment = {
        "CAZSL_PORT": str(port),
        "CAZSL_REGISTRY": str(registry.root),
        "CAZSL_POLL_INTERVAL_S": "0.1",
        "CAZSL_LOG_LEVEL": "WARNING",
    }
    command = [sys.executable, "-c", "from service.cli.main import main; main()", "serve"]
    with log.open("a") as file:
        return subprocess.Popen(command, cwd=ROOT, env={**os.environ, **environment}, stderr=file)


@pytest.fixture
def replicas(tmp_path: Path) -> Iterator[list[Replica]]:
    """Two of them over a copy of the shipped registry, ready."""
    registry = Registry(tmp_path / "models")
    shutil.copytree(ROOT / "models", registry.root)
    both = [Replica.started(registry, tmp_path / f"log-{place}") for place in range(2)]
    try:
        for replica in both:
            wait_until(replica.is_ready)
        yield both
    finally:
        for replica in both:
            replica.kill()


def promote_anew(registry: Registry) -> int:
    """Publish the first version once more, as the champion."""
    first = registry.read(NAME, 1)
    version = registry.publish(first.manifest, first.model, first.card).version
    registry.point_alias(NAME, "champion", version)
    return version


def test_a_promote_reaches_both_replicas(replicas: list[Replica]) -> None:
    """Nobody tells them: each sees it in the registry that they share, and answers with nothing older from then on."""
    for _ in range(3):
        version = promote_anew(replicas[0].registry)
        for replica in replicas:
            wait_until(partial(replica.serves, version))
        assert [replica.version() for replica in replicas for _ in range(5)] == [version] * 10


def test_a_replica_that_is_killed_costs_the_other_nothing_and_comes_back(replicas: list[Replica]) -> None:
    """SIGKILL: the other answers all the while; the killed one refuses, then is not ready, then ready and right."""
    killed, other = replicas
    killed.kill()
    assert killed.readiness() is None
    version = promote_anew(other.registry)
    wait_until(partial(other.serves, version))
    killed.start_again()
    seen = set[int | None]()

    def is_back() -> bool:
        seen.add(killed.readiness())
        return other.serves(version) and 200 in seen

    wait_until(is_back)
    assert killed.version() == version, "it said that it was ready"
    assert seen <= {None, 503, 200}
