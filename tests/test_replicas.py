"""Replicas: two service processes over one registry. A promotion reaches both, and each survives the other."""

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
    """A service process on a port, which can be killed and started again."""

    port: int
    registry: Registry
    log: Path
    process: subprocess.Popen[bytes]

    @classmethod
    def started(cls, registry: Registry, log: Path) -> "Replica":
        """Start the first process. It is not ready yet."""
        port = free_port()
        return cls(port, registry, log, _launched(port, registry, log))

    def start_again(self) -> None:
        """Start the next process on the same port."""
        self.process = _launched(self.port, self.registry, self.log)

    def kill(self) -> None:
        """Kill the process with SIGKILL, and wait for its end."""
        self.process.kill()
        self.process.wait()

    def readiness(self) -> int | None:
        """Return the status of /readyz, or None if the connection is refused."""
        assert self.process.poll() is None or self.process.returncode < 0, self.log.read_text()
        try:
            return self._ask("GET", "/readyz", None)[0]
        except ConnectionError:
            return None

    def is_ready(self) -> bool:
        """Return whether /readyz answers with 200."""
        return self.readiness() == 200

    def serves(self, version: int) -> bool:
        """Return whether this version answers a prediction. The prediction must be answered."""
        return self.version() == version

    def version(self) -> int:
        """Return the version that answers a prediction. The prediction must be answered."""
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
    """Run two replicas over a copy of the shipped registry. Both are ready."""
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


def publish_champion(registry: Registry) -> int:
    """Publish the first version again and make it the champion. Return its number."""
    first = registry.read(NAME, 1)
    version = registry.publish(first.manifest, first.model, first.card).version
    registry.point_alias(NAME, "champion", version)
    return version


def test_a_promote_reaches_both_replicas(replicas: list[Replica]) -> None:
    """A promotion reaches both replicas through the registry. From then on, neither answers with an older version."""
    for _ in range(3):
        version = publish_champion(replicas[0].registry)
        for replica in replicas:
            wait_until(partial(replica.serves, version))
        assert [replica.version() for replica in replicas for _ in range(5)] == [version] * 10


def test_a_killed_replica_does_not_disturb_the_other_and_returns(replicas: list[Replica]) -> None:
    """While one replica is killed and started again, the other answers. The first is ready only with its models."""
    killed, other = replicas
    killed.kill()
    assert killed.readiness() is None
    version = publish_champion(other.registry)
    wait_until(partial(other.serves, version))
    killed.start_again()
    seen = set[int | None]()

    def is_back() -> bool:
        seen.add(killed.readiness())
        return other.serves(version) and 200 in seen

    wait_until(is_back)
    assert killed.version() == version, "the replica was ready before it had the version"
    assert seen <= {None, 503, 200}
