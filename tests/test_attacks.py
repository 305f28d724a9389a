"""Raw bytes against a real service process: the corpus of attacks, slow and endless clients. It answers after each."""

import json
import socket
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.running_service import ROOT, is_ready, rss_mib, serve

CORPUS = sorted((ROOT / "tests" / "attacks" / "http").glob("*.http"))
BODY = b'{"pusher": {"x": -0.075, "y": 0.0, "angle": 0.0}, "context": {"descriptor": "1a2b3c4a"}}'
HEAD = b"POST /v1/predict HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\nConnection: close\r\n"
GROWTH_MIB = 64.0
SLOW_S = 1.0


class Service:
    """A running service and raw connections to it."""

    def __init__(self, port: int, memory: object) -> None:
        self.port = port
        self.memory = memory

    def connect(self) -> socket.socket:
        """A connection that gives up after a minute."""
        return socket.create_connection(("127.0.0.1", self.port), timeout=60.0)

    def send(self, *pieces: bytes) -> tuple[int, dict[str, str], bytes]:
        """Status, headers and body of the answer to these bytes."""
        with self.connect() as connection:
            try:
                for piece in pieces:
                    connection.sendall(piece)
            except (ConnectionResetError, BrokenPipeError):
                pass  # it had answered before all was sent
            return read_answer(connection)


def read_answer(connection: socket.socket) -> tuple[int, dict[str, str], bytes]:
    """Read one answer to the end of its connection."""
    received = b""
    while True:
        try:
            part = connection.recv(1 << 16)
        except ConnectionResetError:
            part = b""
        if not part:
            break
        received += part
        head, found, body = received.partition(b"\r\n\r\n")
        headers = dict(line.lower().split(": ", 1) for line in head.decode("latin-1").split("\r\n")[1:] if ": " in line)
        if found and len(body) >= int(headers.get("content-length", 1 << 40)):
            break
    assert received, "the connection was closed without an answer"
    head, _, body = received.partition(b"\r\n\r\n")
    headers = dict(line.lower().split(": ", 1) for line in head.decode("latin-1").split("\r\n")[1:] if ": " in line)
    return int(head.split()[1]), headers, body


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Service]:
    """A service that waits a second for heads and bodies; its memory is looked at when all is over."""
    with serve(tmp_path_factory.mktemp("attacks"), body_timeout_s=SLOW_S) as (port, process):
        found = Service(port, process)
        assert found.send(HEAD + b"Content-Length: %d\r\n\r\n" % len(BODY) + BODY)[0] == 200
        before = rss_mib(process)
        yield found
        assert rss_mib(process) - before < GROWTH_MIB


@pytest.fixture(autouse=True)
def alive(service: Service) -> Iterator[None]:
    """Every attack ends with the question whether the service answers."""
    yield
    assert is_ready(service.port)


def test_the_corpus_is_there() -> None:
    """A corpus that is not found attacks nothing."""
    assert len(CORPUS) > 45


@pytest.mark.parametrize("path", CORPUS, ids=lambda path: path.stem)
def test_an_attack_gets_the_status_in_its_name(service: Service, path: Path) -> None:
    """As a problem, or as the protocol's error under /v2; without a path, a trace or an echo."""
    status, headers, body = service.send(path.read_bytes())
    assert status == int(path.stem.partition("-")[0]), body
    if status != 200:
        document = json.loads(body)
        if headers["content-type"] == "application/problem+json":
            assert document["status"] == status
        else:
            assert set(document) == {"error"}
    for secret in (b"Traceback", b"site-packages", b"169.254", b"etc/passwd", b"7777777"):
        assert secret not in body


def test_a_body_of_one_byte_a_chunk_is_read(service: Service) -> None:
    """However a client chops it."""
    chunks = b"".join(b"1\r\n%c\r\n" % byte for byte in BODY) + b"0\r\n\r\n"
    assert service.send(HEAD + b"Transfer-Encoding: chunked\r\n\r\n", chunks)[0] == 200


def test_a_million_tiny_chunks_are_bounded(service: Service) -> None:
    """They end as a body that is no JSON, or as one that is not there in time."""
    head = HEAD + b"Transfer-Encoding: chunked\r\n\r\n"
    status, _, _ = service.send(head, *([b"1\r\n \r\n" * 10_000] * 100), b"0\r\n\r\n")
    assert status in (400, 408)


def test_chunks_beyond_the_limit_are_refused_without_an_end(service: Service) -> None:
    """13 MiB of a body that never ends."""
    chunk = b"100000\r\n" + b" " * (1 << 20) + b"\r\n"
    assert service.send(HEAD + b"Transfer-Encoding: chunked\r\n\r\n", *([chunk] * 13))[0] == 413


def test_a_head_without_end_is_refused(service: Service) -> None:
    """One header of a megabyte, and many small ones."""
    assert service.send(b"GET /livez HTTP/1.1\r\nX: ", *([b"a" * 65536] * 16))[0] == 431
    assert service.send(b"GET /livez HTTP/1.1\r\n", *([b"X: a\r\n" * 10_000] * 16))[0] == 431
    assert service.send(b"GET /", *([b"a" * 65536] * 16))[0] == 431


@pytest.mark.parametrize(
    ("start", "drip", "code"),
    [
        (b"", b"\r\n", "slow_head"),
        (b"GET /livez HTTP/1.1\r\nX: ", b"a", "slow_head"),
        (HEAD + b"Content-Length: 5000\r\n\r\n", b" ", "slow_body"),
        (HEAD + b"Transfer-Encoding: chunked\r\n\r\n", b"1\r\n \r\n", "slow_body"),
    ],
    ids=["empty lines", "head", "body", "chunks"],
)
def test_a_client_that_drips_is_cut(service: Service, start: bytes, drip: bytes, code: str) -> None:
    """408 after the time that it has; the byte it sends now and then buys nothing. Others are answered meanwhile."""
    with service.connect() as slow:
        slow.sendall(start)
        done = threading.Event()

        def dripping() -> None:
            while not done.wait(0.05):
                try:
                    slow.sendall(drip)
                except OSError:
                    return

        thread = threading.Thread(target=dripping)
        thread.start()
        try:
            assert is_ready(service.port)
            status, headers, body = read_answer(slow)
        finally:
            done.set()
            thread.join()
    assert (status, json.loads(body)["code"], headers["connection"]) == (408, code, "close")


def test_a_client_that_says_nothing_is_cut(service: Service) -> None:
    """Two hundred of them, and others are answered meanwhile."""
    silent = [service.connect() for _ in range(200)]
    try:
        assert is_ready(service.port)
        assert [read_answer(connection)[0] for connection in silent] == [408] * 200
    finally:
        for connection in silent:
            connection.close()


def test_clients_that_vanish_leave_nothing(service: Service) -> None:
    """In the middle of a body, three hundred times."""
    for _ in range(300):
        with service.connect() as connection:
            connection.sendall(HEAD + b"Content-Length: 100000\r\n\r\n" + b" " * 50_000)


def test_pipelined_requests_are_answered_in_order(service: Service) -> None:
    """A hundred requests in one go on one connection."""
    request = HEAD.replace(b"Connection: close\r\n", b"") + b"Content-Length: %d\r\n\r\n" % len(BODY) + BODY
    with service.connect() as connection:
        connection.sendall(request * 100)
        received = b""
        end = time.monotonic() + 60.0
        while received.count(b"HTTP/1.1 200 OK") < 100 and time.monotonic() < end:
            received += connection.recv(1 << 16)
    assert received.count(b"HTTP/1.1 200 OK") == 100
