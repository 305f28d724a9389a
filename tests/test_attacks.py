"""Attacks on a service process with raw bytes: the corpus of attacks, slow clients, bodies and heads without an end."""

import json
import re
import socket
import struct
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.running_service import ROOT, is_ready, rss_mib, serve, wait_until

CORPUS = sorted((ROOT / "tests" / "attacks" / "http").glob("*.http"))
BODY = b'{"pusher": {"x": -0.075, "y": 0.0, "angle": 0.0}, "context": {"descriptor": "1a2b3c4a"}}'
HEAD = b"POST /v1/predict HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\nConnection: close\r\n"
GROWTH_MIB = 64.0
ROLLED_OUT = 'cazsl_requests_total{route="/v1/rollout",status="200"}'
SLOW_S = 1.0


class Service:
    """A running service and raw connections to it."""

    def __init__(self, port: int, memory: object) -> None:
        self.port = port
        self.memory = memory

    def connect(self) -> socket.socket:
        """Connect, with a timeout of a minute."""
        return socket.create_connection(("127.0.0.1", self.port), timeout=60.0)

    def send(self, *pieces: bytes) -> tuple[int, dict[str, str], bytes]:
        """Send bytes. Return status, headers and body of the answer."""
        with self.connect() as connection:
            try:
                for piece in pieces:
                    connection.sendall(piece)
            except (ConnectionResetError, BrokenPipeError):
                pass  # the service answered before all bytes were sent
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
    """Run a service that waits a second for clients. Check after all tests that its memory is bounded."""
    limits = {"body_timeout_s": SLOW_S, "answer_timeout_s": SLOW_S}
    with serve(tmp_path_factory.mktemp("attacks"), **limits) as (port, process):
        found = Service(port, process)
        assert found.send(HEAD + b"Content-Length: %d\r\n\r\n" % len(BODY) + BODY)[0] == 200
        before = rss_mib(process)
        yield found
        assert rss_mib(process) - before < GROWTH_MIB


@pytest.fixture(autouse=True)
def alive(service: Service) -> Iterator[None]:
    """Check after every attack that the service is ready."""
    yield
    assert is_ready(service.port)


def test_the_corpus_is_found() -> None:
    """The corpus of attacks is found. Without it the other tests would pass without an attack."""
    assert len(CORPUS) > 45


@pytest.mark.parametrize("path", CORPUS, ids=lambda path: path.stem)
def test_an_attack_gets_the_status_in_its_name(service: Service, path: Path) -> None:
    """An attack gets the status in its file name, as a problem or an error of /v2, without a path or a traceback."""
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
    """A body that is sent in chunks of one byte is read like any other."""
    chunks = b"".join(b"1\r\n%c\r\n" % byte for byte in BODY) + b"0\r\n\r\n"
    assert service.send(HEAD + b"Transfer-Encoding: chunked\r\n\r\n", chunks)[0] == 200


def test_a_million_tiny_chunks_are_bounded(service: Service) -> None:
    """A million tiny chunks are refused as a malformed body or as a slow one."""
    head = HEAD + b"Transfer-Encoding: chunked\r\n\r\n"
    status, _, _ = service.send(head, *([b"1\r\n \r\n" * 10_000] * 100), b"0\r\n\r\n")
    assert status in (400, 408)


def test_chunks_beyond_the_limit_are_refused_without_an_end(service: Service) -> None:
    """A chunked body over the limit is refused with 413 before it ends. This one has 13 MiB."""
    chunk = b"100000\r\n" + b" " * (1 << 20) + b"\r\n"
    assert service.send(HEAD + b"Transfer-Encoding: chunked\r\n\r\n", *([chunk] * 13))[0] == 413


def test_a_head_without_end_is_refused(service: Service) -> None:
    """A head without an end is refused with 431: one header of a megabyte, many small headers, or a long target."""
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
def test_a_client_that_drips_gets_a_408(service: Service, start: bytes, drip: bytes, code: str) -> None:
    """A client that sends a byte now and then gets a 408 after the time limit. Other clients are answered meanwhile."""
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


def test_silent_clients_get_a_408(service: Service) -> None:
    """Two hundred clients that send no byte get a 408. Other clients are answered meanwhile."""
    silent = [service.connect() for _ in range(200)]
    try:
        assert is_ready(service.port)
        assert [read_answer(connection)[0] for connection in silent] == [408] * 200
    finally:
        for connection in silent:
            connection.close()


def test_clients_that_disconnect_in_a_body_do_no_harm(service: Service) -> None:
    """Three hundred clients disconnect in the middle of a body. The service stays ready, and its memory bounded."""
    for _ in range(300):
        with service.connect() as connection:
            connection.sendall(HEAD + b"Content-Length: 100000\r\n\r\n" + b" " * 50_000)


def test_pipelined_requests_are_answered_in_order(service: Service) -> None:
    """A hundred requests that are sent at once on one connection get a hundred answers."""
    request = HEAD.replace(b"Connection: close\r\n", b"") + b"Content-Length: %d\r\n\r\n" % len(BODY) + BODY
    with service.connect() as connection:
        connection.sendall(request * 100)
        received = b""
        end = time.monotonic() + 60.0
        while received.count(b"HTTP/1.1 200 OK") < 100 and time.monotonic() < end:
            received += connection.recv(1 << 16)
    assert received.count(b"HTTP/1.1 200 OK") == 100


def test_clients_that_do_not_read_are_cut_off(service: Service) -> None:
    """A hundred clients send many requests and read no answer. Every route answers meanwhile, and they are cut off."""
    wanted = b"GET /docs/swagger-ui-bundle.js HTTP/1.1\r\nHost: localhost\r\n\r\n"
    push = HEAD.replace(b"Connection: close\r\n", b"") + b"Content-Length: %d\r\n\r\n" % len(BODY) + BODY
    deaf = [service.connect() for _ in range(100)]
    try:
        for number, connection in enumerate(deaf):
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            connection.sendall((wanted, push)[number % 2] * 20)
        for path in (b"/livez", b"/readyz", b"/metrics", b"/v1/models"):
            assert service.send(b"GET %b HTTP/1.1\r\nHost: a\r\nConnection: close\r\n\r\n" % path)[0] == 200
        assert service.send(HEAD + b"Content-Length: %d\r\n\r\n" % len(BODY) + BODY)[0] == 200
        wait_until(lambda: metric(service, 'cazsl_refusals_total{reason="slow_reader"}') >= 50)
    finally:
        for connection in deaf:
            connection.close()


def metric(service: Service, name: str) -> float:
    """Return the value of a metric, or 0 before its first."""
    text = service.send(b"GET /metrics HTTP/1.1\r\nHost: a\r\nConnection: close\r\n\r\n")[2].decode()
    found = re.search(rf"^{re.escape(name)} (\S+)", text, re.MULTILINE)
    return float(found[1]) if found else 0.0


@pytest.mark.parametrize("path", ["/v1/predict", "/v1/predict/batch", "/v1/models"])
def test_a_client_that_shuts_its_sending_half_gets_all_answers(service: Service, path: str) -> None:
    """Three requests in one write and an end get three answers and an end, by the loop, a thread and the framework."""
    batch = json.dumps({"pushers": [[-0.075, 0.0, 0.0]] * 2000, "contexts": [{"descriptor": "1a2b3c4a"}]}).encode()
    body = {"/v1/predict": BODY, "/v1/predict/batch": batch, "/v1/models": b""}[path]
    head = HEAD.replace(b"Connection: close\r\n", b"").replace(b"/v1/predict", path.encode())
    head = head if body else head.replace(b"POST", b"GET")
    with service.connect() as connection:
        connection.sendall((head + b"Content-Length: %d\r\n\r\n" % len(body) + body) * 3)
        connection.shutdown(socket.SHUT_WR)
        received = b"".join(iter(lambda: connection.recv(1 << 16), b""))
    assert received.count(b"HTTP/1.1 200 OK") == 3


@pytest.mark.parametrize("is_reset", [False, True])
def test_the_work_for_a_client_that_has_left_ends(service: Service, is_reset: bool) -> None:
    """A rollout of 100,000 particles is neither finished nor answered once its client closes or resets."""
    push = {"x": -0.1, "y": 0.0, "angle": 0.0}
    question: dict[str, object] = {"context": {"outline": [[0.06, 0.04], [-0.06, 0.04], [-0.06, -0.04], [0.06, -0.04]]}}
    question |= {"object_pose": {"x": 0.0, "y": 0.0, "angle": 0.0}, "sequences": [[push] * 50] * 200}
    body = json.dumps(question).encode()
    before = metric(service, ROLLED_OUT)
    connection = service.connect()
    head = HEAD.replace(b"/v1/predict", b"/v1/rollout").replace(b"Connection: close\r\n", b"")
    connection.sendall(head + b"Content-Length: %d\r\n\r\n" % len(body) + body)
    wait_until(lambda: metric(service, "cazsl_worker_jobs") == 1.0)
    if is_reset:
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    connection.close()
    wait_until(lambda: metric(service, "cazsl_worker_jobs") == 0.0)
    assert metric(service, ROLLED_OUT) == before


def test_an_early_refusal_is_read_by_a_client_that_sends_on(service: Service) -> None:
    """A client that is refused at its head reads one answer and an end, though it sends megabytes and a second head."""
    for refused, status in ((HEAD + b"Content-Length: 99999999\r\n\r\n", 413), (b"nonsense\r\n\r\n", 400)):
        with service.connect() as connection:
            connection.sendall(refused)
            for _ in range(20):
                connection.sendall(b" " * (1 << 18))
            connection.sendall(b"\r\n\r\nGET /livez HTTP/1.1\r\nHost: a\r\n\r\n")
            received = b"".join(iter(lambda: connection.recv(1 << 16), b""))
        assert received.startswith(b"HTTP/1.1 %d " % status)
        assert received.count(b"HTTP/1.1 ") == 1
        assert b"\r\nx-request-id: " in received


def test_an_idle_connection_makes_room_and_ends_in_time(tmp_path: Path) -> None:
    """At the limit of connections a new client is served and the longest idle one is closed. The others end in time."""
    request = b"GET /livez HTTP/1.1\r\nHost: a\r\n\r\n"
    with serve(tmp_path, max_connections=8, keep_alive_s=3.0) as (port, process):
        service = Service(port, process)
        idle = [service.connect() for _ in range(8)]
        for connection in idle:
            connection.sendall(request)
            assert connection.recv(1 << 16).startswith(b"HTTP/1.1 200 ")
        with service.connect() as newcomer:
            newcomer.sendall(request)
            assert newcomer.recv(1 << 16).startswith(b"HTTP/1.1 200 ")
            assert idle[0].recv(1 << 16) == b""
            idle[7].sendall(request)
            assert idle[7].recv(1 << 16).startswith(b"HTTP/1.1 200 ")
            for connection in (*idle[1:], newcomer):
                assert connection.recv(1 << 16) == b""
        for connection in idle:
            connection.close()


def test_health_answers_while_all_other_requests_are_refused(tmp_path: Path) -> None:
    """While no byte of a request may be held, predictions get a 503, and the routes of health answer."""
    with serve(tmp_path, max_held_bytes=1 << 20, body_timeout_s=30.0) as (port, process):
        service = Service(port, process)
        holders = [service.connect() for _ in range(2)]
        for connection in holders:
            connection.sendall(HEAD + b"Content-Length: 700000\r\n\r\n" + b" " * 380_000)
        wait_until(lambda: metric(service, "cazsl_request_bytes_held") >= 760_000)
        assert service.send(HEAD + b"Content-Length: 300000\r\n\r\n" + b" " * 300_000)[0] == 503
        for path in (b"/livez", b"/readyz", b"/metrics", b"/v2/health/live", b"/v2/health/ready"):
            assert service.send(b"GET %b HTTP/1.1\r\nHost: a\r\nConnection: close\r\n\r\n" % path)[0] == 200
        for connection in holders:
            connection.close()
