"""Service process as operators run it: with sockets, signals and the shipped models."""

import base64
import http.client
import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from service.registry.registry import Registry
from tests.attacks.hostile_images import exif_bomb, jpeg_with
from tests.running_service import PATIENCE_S, free_port, is_ready, wait_until

BODY = json.dumps({"pusher": {"x": -0.075, "y": 0.0, "angle": 0.0}, "context": {"descriptor": "1a2b3c4a"}}).encode()
JSON = {"Content-Type": "application/json"}


@dataclass
class Running:
    """A service process and its registry."""

    process: subprocess.Popen[str]
    port: int
    registry: Registry

    def ask(self, method: str, path: str, body: bytes | None = None) -> tuple[int, Any]:
        """Send a request on a new connection. Return status and JSON of the answer."""
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=PATIENCE_S)
        try:
            connection.request(method, path, body, JSON)
            response = connection.getresponse()
            return response.status, json.loads(response.read())
        finally:
            connection.close()

    def served_version(self) -> int:
        """Return the version of the champion, as a prediction names it."""
        status, answer = self.ask("POST", "/v1/predict", BODY)
        assert status == 200, answer
        return int(answer["model"]["version"])

    def serves(self, version: int) -> bool:
        """Return whether the champion is this version."""
        return self.served_version() == version

    def publish(self) -> int:
        """Publish the first version again and make it the champion. Return its number."""
        version = publish_again(self.registry)
        self.registry.point_alias("push-indicator", "champion", version)
        return version


def publish_again(registry: Registry) -> int:
    """Publish the first version as the next one. Return its number."""
    first = registry.read("push-indicator", 1)
    return registry.publish(first.manifest, first.model, first.card).version


@pytest.fixture
def running(project_root: Path, tmp_path: Path) -> Iterator[Running]:
    """Run a service over a copy of the shipped registry, with ten polls a second."""
    root = tmp_path / "models"
    shutil.copytree(project_root / "models", root)
    port = free_port()
    environment = {"CAZSL_PORT": str(port), "CAZSL_REGISTRY": str(root), "CAZSL_POLL_INTERVAL_S": "0.1"}
    with (tmp_path / "log").open("w") as log:
        process = subprocess.Popen(
            [sys.executable, "-c", "from service.cli.main import main; main()", "serve"],
            cwd=project_root,
            env={**os.environ, **environment},
            stderr=log,
            text=True,
        )
    found = Running(process, port, Registry(root))

    def answers() -> bool:
        assert process.poll() is None, (tmp_path / "log").read_text()
        try:
            return found.ask("GET", "/readyz")[0] == 200
        except OSError:
            return False

    wait_until(answers)
    yield found
    process.kill()
    process.wait()


def test_the_request_of_the_readme_is_answered(running: Running) -> None:
    """The request of the README gets a mean and a std from the champion of push-indicator."""
    status, answer = running.ask("POST", "/v1/predict", BODY)
    assert status == 200
    champion = running.registry.aliases("push-indicator")["champion"]
    assert answer["model"] == {"name": "push-indicator", "version": champion}
    assert 0.0 < answer["mean"]["x"] < 0.05
    assert all(0.0 < value < 1.0 for value in answer["std"].values())


def test_new_versions_are_served_without_a_restart_or_a_lost_request(running: Running) -> None:
    """Four clients send requests while three versions appear. Every answer is a 200, the last from the newest one."""
    stop, failures, versions = threading.Event(), [], set()
    before = running.served_version()

    def send_requests() -> None:
        connection = http.client.HTTPConnection("127.0.0.1", running.port, timeout=PATIENCE_S)
        while not stop.is_set():
            connection.request("POST", "/v1/predict", BODY, JSON)
            response = connection.getresponse()
            answer = json.loads(response.read())
            if response.status != 200:
                failures.append(answer)
                return
            versions.add(answer["model"]["version"])
        connection.close()

    clients = [threading.Thread(target=send_requests) for _ in range(4)]
    for client in clients:
        client.start()
    for _ in range(3):
        version = running.publish()
        wait_until(partial(running.serves, version))
    stop.set()
    for client in clients:
        client.join()
    assert failures == []
    assert {before, version} <= versions
    assert version == running.registry.versions("push-indicator")[-1]


def test_a_broken_version_is_not_served(running: Running, tmp_path: Path) -> None:
    """If an alias moves to a broken version, the previous version answers, and /readyz names the broken file."""
    before, elsewhere = running.served_version(), Registry(tmp_path / "elsewhere")
    shutil.copytree(running.registry.root, elsewhere.root)
    version = publish_again(elsewhere)
    broken = elsewhere.root / "push-indicator" / str(version)
    (broken / "model.onnx").write_bytes(b"torn")
    broken.rename(running.registry.root / "push-indicator" / str(version))
    (running.registry.root / "push-indicator" / "aliases" / "champion").write_text(f"{version}\n")
    wait_until(lambda: running.ask("GET", "/readyz")[1]["problems"])
    status, ready = running.ask("GET", "/readyz")
    assert status == 200
    assert any(f"push-indicator@{version} is broken" in text and "model.onnx" in text for text in ready["problems"])
    assert running.served_version() == before


def test_a_request_that_is_half_sent_at_sigterm_is_answered(running: Running) -> None:
    """A request of which half is sent when SIGTERM comes is answered. Then the process ends with exit status 0."""
    with socket.create_connection(("127.0.0.1", running.port), timeout=PATIENCE_S) as connection:
        lines = (
            "POST /v1/predict HTTP/1.1",
            "Host: x",
            "Content-Type: application/json",
            f"Content-Length: {len(BODY)}",
        )
        connection.sendall("\r\n".join(lines).encode() + b"\r\n\r\n" + BODY[:10])
        running.ask("GET", "/livez")  # by its answer the earlier bytes have been read
        running.process.send_signal(signal.SIGTERM)
        wait_until(lambda: not accepts(running.port))
        connection.sendall(BODY[10:])
        answer = b""
        while part := connection.recv(65536):
            answer += part
    assert answer.startswith(b"HTTP/1.1 200")
    assert b"push-indicator" in answer
    assert running.process.wait(PATIENCE_S) == 0


def accepts(port: int) -> bool:
    """Return whether a port accepts connections."""
    try:
        socket.create_connection(("127.0.0.1", port), timeout=1.0).close()
    except OSError:
        return False
    return True


def test_two_instances_that_restart_in_turn_lose_no_accepted_request(project_root: Path, tmp_path: Path) -> None:
    """Two instances over one registry restart in turn under load from four clients. Every accepted request is answered.

    Clients keep their connections for as long as the service does. They connect to the other instance when a
    connection is refused, or reset before its first answer, because then it was still in the queue of a closed socket.
    A request on a connection that has answered is never sent again. benchmarks/drain.py measures the same with nginx
    and wrk, and counts the resets.
    """
    shutil.copytree(project_root / "models", tmp_path / "models")
    ports = [free_port(), free_port()]
    processes: dict[int, subprocess.Popen[bytes]] = {}

    def start(port: int) -> None:
        environment = {"CAZSL_PORT": str(port), "CAZSL_REGISTRY": str(tmp_path / "models"), "CAZSL_DRAIN_S": "0.3"}
        with (tmp_path / "log").open("a") as log:
            processes[port] = subprocess.Popen(
                [sys.executable, "-c", "from service.cli.main import main; main()", "serve"],
                cwd=project_root,
                env={**os.environ, **environment},
                stderr=log,
            )
        wait_until(lambda: is_ready(port))

    stop, failures, answered = threading.Event(), list[object](), [0]

    def send_requests() -> None:
        connection, has_answered = None, False
        while not stop.is_set():
            try:
                if connection is None:
                    connection, has_answered = connected(ports), False
                connection.request("POST", "/v1/predict", BODY, JSON)
                response = connection.getresponse()
                body = response.read()
            except ConnectionError as error:
                if has_answered:
                    failures.append(error)
                    return
                connection = None
                continue
            has_answered = True
            if response.status != 200:
                failures.append(body)
            answered[0] += 1
            if connection.sock is None:  # the service closed the connection
                connection = None
        if connection is not None:
            connection.close()

    for port in ports:
        start(port)
    clients = [threading.Thread(target=send_requests) for _ in range(4)]
    try:
        for client in clients:
            client.start()
        for number in range(4):
            port = ports[number % 2]
            processes[port].terminate()
            assert processes[port].wait(PATIENCE_S) == 0
            start(port)
    finally:
        stop.set()
        for client in clients:
            client.join()
        for process in processes.values():
            process.kill()
            process.wait()
    assert failures == []
    assert answered[0] > 0


def connected(ports: list[int]) -> http.client.HTTPConnection:
    """Connect to the first instance that accepts."""
    while True:
        for port in ports:
            connection = http.client.HTTPConnection("127.0.0.1", port, timeout=PATIENCE_S)
            try:
                connection.connect()
            except ConnectionRefusedError:
                connection.close()
                continue
            return connection


def test_metrics_can_have_a_port_of_their_own(project_root: Path, tmp_path: Path) -> None:
    """With CAZSL_METRICS_PORT, Prometheus reads the metrics on a port of their own."""
    port, metrics_port = free_port(), free_port()
    environment = {"CAZSL_PORT": str(port), "CAZSL_METRICS_PORT": str(metrics_port), "CAZSL_LOG_LEVEL": "WARNING"}
    process = subprocess.Popen(
        [sys.executable, "-c", "from service.cli.main import main; main()", "serve"],
        cwd=project_root,
        env={**os.environ, **environment},
    )
    try:
        wait_until(lambda: is_ready(port))
        connection = http.client.HTTPConnection("127.0.0.1", metrics_port, timeout=PATIENCE_S)
        connection.request("GET", "/metrics")
        text = connection.getresponse().read().decode()
        connection.close()
        assert "\ncazsl_ready 1.0\n" in text
        process.terminate()
        assert process.wait(PATIENCE_S) == 0
    finally:
        process.kill()
        process.wait()


def test_a_picture_does_not_write_to_the_log(running: Running, tmp_path: Path) -> None:
    """A picture of thousands of broken tags is one line in the log: Pillow would warn about each tag."""
    picture = base64.b64encode(jpeg_with(0xE1, b"Exif\0\0" + exif_bomb())).decode()
    body = {"pusher": {"x": -0.075, "y": 0.0, "angle": 0.0}, "context": {"image": picture}}

    def lines() -> int:
        """Count the lines of the log."""
        return len((tmp_path / "log").read_text().splitlines())

    before = lines()
    status, answer = running.ask("POST", "/v1/predict", json.dumps(body).encode())
    assert status == 200, answer
    wait_until(lambda: lines() > before)
    assert lines() < before + 10
