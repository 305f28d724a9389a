"""The process is gone in time after SIGTERM, whatever its threads do."""

import http.client
import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import pytest

from service.background.ending import FAILED, LAST_S
from tests.hanging_service import HANGS
from tests.running_service import PATIENCE_S, free_port, is_ready, wait_until

GRACE_S = 1
BUSY_S = 5.0  # for a machine that is busy. A process that awaits a thread would take an hour
LARGE_BATCH = json.dumps({"pushers": [[-0.075, 0.0, 0.0]] * 1000, "contexts": [{"descriptor": "1a2b3c4a"}]}).encode()


@contextmanager
def started(
    project_root: Path, code: list[str], stderr: int, **settings: object
) -> Iterator[tuple[subprocess.Popen[bytes], int]]:
    """Start a service process and yield it with its port. Kill it at the end."""
    port = free_port()
    environment = {f"CAZSL_{name.upper()}": str(value) for name, value in settings.items()}
    process = subprocess.Popen(
        [sys.executable, *code],
        cwd=project_root,
        env={**os.environ, "CAZSL_PORT": str(port), "CAZSL_GRACE_S": str(GRACE_S), **environment},
        stderr=stderr,
    )
    try:
        yield process, port
    finally:
        process.kill()
        process.wait()


def seconds_to_end(process: subprocess.Popen[bytes], number: int = signal.SIGTERM) -> float:
    """Send a signal and return the time until the process is gone."""
    began = time.monotonic()
    process.send_signal(number)
    process.wait(PATIENCE_S)
    return time.monotonic() - began


def send(port: int, answers: list[bytes], method: str, path: str, body: bytes | None = None) -> threading.Thread:
    """Send a request in a thread, which ends with the connection. Add its answer, if there is one."""

    def ask() -> None:
        connection = http.client.HTTPConnection("127.0.0.1", port, timeout=PATIENCE_S)
        try:
            connection.request(method, path, body, {"Content-Type": "application/json"})
            answers.append(connection.getresponse().read())
        except (OSError, http.client.HTTPException):  # the service has ended
            pass
        finally:
            connection.close()

    thread = threading.Thread(target=ask)
    thread.start()
    return thread


@contextmanager
def silent() -> Iterator[int]:
    """Listen on a port, accept connections and never answer. Yield the port."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        kept: list[socket.socket] = []

        def accept() -> None:
            while True:
                try:
                    kept.append(server.accept()[0])
                except OSError:
                    return

        thread = threading.Thread(target=accept)
        thread.start()
        yield int(server.getsockname()[1])
        server.shutdown(socket.SHUT_RDWR)
        thread.join()
        for connection in kept:
            connection.close()


def test_a_hanging_thread_of_every_purpose_does_not_delay_the_end(project_root: Path) -> None:
    """Polls, probes, requests, scrapes, spans, lines of the log and threads of libraries hang. The process ends with 0.

    The pipe of its standard error is full and not read, and the collector of spans never answers.
    """
    reader, writer = os.pipe()
    fill(writer)
    settings: Mapping[str, object] = {
        "poll_interval_s": 0.05,
        "probe_interval_s": 0.05,
        "log_level": "DEBUG",
        "deadline_s": 1,
    }
    with (
        silent() as collector,
        started(
            project_root,
            ["-m", "tests.hanging_service", *HANGS],
            writer,
            otlp_endpoint=f"http://127.0.0.1:{collector}/v1/traces",
            **settings,
        ) as (process, port),
    ):
        wait_until(lambda: accepts(port) and "did not end" in readyz(port))  # models are loaded, and probes hang
        batches, scrapes = list[bytes](), list[bytes]()
        requests = [send(port, batches, "POST", "/v1/predict/batch", LARGE_BATCH) for _ in range(4)]
        requests += [send(port, scrapes, "GET", "/metrics") for _ in range(4)]
        wait_until(lambda: len(batches) == 4)
        assert all(b"deadline_exceeded" in answer for answer in batches)  # their threads hang
        assert seconds_to_end(process) < GRACE_S + LAST_S + BUSY_S
        assert process.returncode == 0
        for thread in requests:
            thread.join()
        assert not any(b"cazsl_ready" in answer for answer in scrapes)
    os.close(reader)
    os.close(writer)


def fill(writer: int) -> None:
    """Fill a pipe."""
    os.set_blocking(writer, False)
    try:
        while True:
            os.write(writer, b"x" * 65536)
    except BlockingIOError:
        os.set_blocking(writer, True)


def readyz(port: int) -> str:
    """Return the body of /readyz."""
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=PATIENCE_S)
    connection.request("GET", "/readyz")
    text = connection.getresponse().read().decode()
    connection.close()
    return text


def accepts(port: int) -> bool:
    """Return whether a port accepts connections."""
    try:
        socket.create_connection(("127.0.0.1", port), timeout=1.0).close()
    except OSError:
        return False
    return True


def test_a_silent_bucket_does_not_delay_the_end(project_root: Path, tmp_path: Path) -> None:
    """A bucket that accepts connections and never answers holds a thread of the library. The process ends with 0."""
    with silent() as bucket, pytest.MonkeyPatch.context() as patch:
        for name, value in {
            "AWS_ENDPOINT_URL": f"http://127.0.0.1:{bucket}",
            "AWS_ACCESS_KEY_ID": "key",
            "AWS_SECRET_ACCESS_KEY": "secret",
            "AWS_REGION": "nowhere",
        }.items():
            patch.setenv(name, value)
        code = ["-c", "from service.cli.main import main; main()", "serve"]
        settings = {"registry": "s3://bucket/models", "cache": tmp_path}
        with started(project_root, code, subprocess.DEVNULL, **settings) as (process, port):
            wait_until(lambda: accepts(port))
            assert seconds_to_end(process) < GRACE_S + LAST_S + BUSY_S
            assert process.returncode == 0


def test_ctrl_c_ends_the_process_with_0(project_root: Path) -> None:
    """Ctrl-C skips the drain time, and the end is orderly."""
    code = ["-c", "from service.cli.main import main; main()", "serve"]
    with started(project_root, code, subprocess.DEVNULL, drain_s=3600) as (process, port):
        wait_until(lambda: is_ready(port))
        assert seconds_to_end(process, signal.SIGINT) < GRACE_S + LAST_S + BUSY_S
        assert process.returncode == 0


EARLY = """
import gc, os, signal
import service.cli.serve as serve
from service.cli.main import main
{call} = lambda *_: os.kill(os.getpid(), signal.SIGTERM)
main()
"""


@pytest.mark.parametrize("call", ["serve.configured", "serve.expect_trials", "gc.collect", "gc.freeze"])
def test_sigterm_before_the_server_handles_it_is_not_lost(project_root: Path, call: str) -> None:
    """A service that is stopped while it starts ends with 0, and does not start all the same."""
    with started(project_root, ["-c", EARLY.format(call=call), "serve"], subprocess.DEVNULL) as (process, _):
        assert process.wait(PATIENCE_S) == 0


END = """
import {imports}
from service.background.ending import Ending
ending = Ending([lambda: print("last", flush=True), lambda: time.sleep(3600)])
ending.start()
ending.begin(0.2)
{then}
"""


@pytest.mark.parametrize(
    ("then", "status"),
    [
        ("ending.leave(0)", 0),
        ("time.sleep(3600)", FAILED),
        ("ctypes.PyDLL(None).sleep(3600)", -signal.SIGALRM),  # never gives up the interpreter lock
    ],
    ids=["last work hangs", "server hangs", "interpreter lock is held"],
)
def test_the_watch_ends_a_process_that_does_not_end(project_root: Path, then: str, status: int) -> None:
    """The exit status says whether the server ended, and the last works are done if they can be."""
    code = END.format(imports="ctypes, time", then=then)
    began = time.monotonic()
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=project_root, capture_output=True, text=True, check=False, timeout=PATIENCE_S
    )
    assert time.monotonic() - began < 0.2 + 2 * LAST_S + BUSY_S
    assert done.returncode == status
    assert done.stdout == ("" if status < 0 else "last\n")
    assert ("did not end in time" in done.stderr) == (status == FAILED)
