"""Worst requests: time, memory and answers of the worst request for every field of every route, one after the other.

    python -m benchmarks.worst_requests [--size BYTES] [--only TEXT] [--every 1] [--report FILE] [--service FOLDER]

A service runs with its default settings over the shipped models, with the allocator settings of its image. Its OpenAPI
document names the routes and fields. For each request this benchmark measures:

- **held**: how long the event loop was held. A process of its own asks ``/livez`` every 5 ms on one connection. The
  longest answer is an upper bound: on a shared machine the probe waits for a processor too. A request over the goal is
  sent again, up to ``REPEATS`` times, and its shortest hold counts.
- **peak**: the largest resident memory while the request is answered, above that of the idle service. The service, with
  its processes, is measured again ``RETURN_S`` after the worst requests: memory must be given back.
- **answer**: status and size. A refusal has a few KiB, at most ten faults, and repeats nothing that was sent.

The benchmark fails if a goal is missed, or the service ends or answers with a 500. With ``--limit-mib`` the service
runs in a control group with that limit of memory (as root, with cgroup v1 or v2).
"""

import argparse
import http.client
import json
import multiprocessing
import os
import platform
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from datetime import date
from multiprocessing.sharedctypes import Synchronized
from pathlib import Path
from typing import Any, Final

from tqdm import tqdm

from benchmarks.cluster import ALLOCATOR
from benchmarks.http_load import OURS, ROOT, free_port, predicts
from benchmarks.worst_bodies import MARK, WorstRequest, worst_requests
from benchmarks.worst_valid import valid_requests
from service.processors import processors

HELD_MS: Final = 50.0
PEAK_MIB: Final = 150.0
ANSWER_BYTES: Final = 8 * 1024
KEPT_MIB: Final = 64.0
"""Memory that stays for the next requests: of the runtime, of threads, of imported codecs."""
RETURN_S: Final = 5.0
REPEATS: Final = 3
PROBE_EVERY_S: Final = 0.005
TIMEOUT_S: Final = 120.0
SHOWN: Final = 12
AT_ONCE: Final = 8


@dataclass(frozen=True)
class Outcome:
    """Outcome of one request."""

    request: WorstRequest
    sent_bytes: int
    status: int
    answer_bytes: int
    took_ms: float
    held_ms: float
    peak_mib: float
    problems: tuple[str, ...] = ()


class Watched:
    """A running service, watched by a process that asks for its liveness."""

    def __init__(self, port: int, pid: int, longest: "Synchronized[float]") -> None:
        self.port = port
        self.pid = pid
        self._longest = longest
        self.idle_mib = 0.0

    def settle(self) -> None:
        """Note the memory of the idle service."""
        time.sleep(RETURN_S)
        self.idle_mib = self.rss_mib("VmRSS")

    def rss_mib(self, line: str) -> float:
        """Return a line of the status of the process, in MiB: ``VmRSS`` now, or ``VmHWM`` at its peak."""
        status = Path(f"/proc/{self.pid}/status").read_text().split("\n")
        return int(next(text for text in status if text.startswith(line)).split()[1]) / 1024

    def measure(self, request: WorstRequest) -> Outcome:
        """Send a request and measure it."""
        body = request.body()
        Path(f"/proc/{self.pid}/clear_refs").write_text("5")  # forgets the peak
        self._longest.value = 0.0
        began = time.monotonic()
        status, answer = send(self.port, request, body)
        took_ms = (time.monotonic() - began) * 1e3
        time.sleep(3 * PROBE_EVERY_S)  # the probe that was waiting
        held_ms, peak_mib = self._longest.value * 1e3, self.rss_mib("VmHWM") - self.idle_mib
        found = Outcome(request, len(body), status, len(answer), took_ms, held_ms, peak_mib)
        return replace(found, problems=tuple(_problems(found, answer)))


def _problems(found: Outcome, answer: bytes) -> Iterator[str]:
    """Yield each missed goal of an outcome."""
    if found.status >= 500 and found.status != 503:
        yield f"status {found.status}"
    if found.held_ms > HELD_MS:
        yield f"held {found.held_ms:.0f} ms"
    if found.peak_mib > PEAK_MIB:
        yield f"peak {found.peak_mib:.0f} MiB"
    if found.status == 200:
        return
    if len(answer) > ANSWER_BYTES:
        yield f"an answer of {len(answer)} bytes"
    if 2 * MARK.encode() in answer:
        yield "an answer that repeats the request"
    if answer.startswith(b'{"type"') and len(json.loads(answer)["errors"]) > 10:
        yield "more than ten faults"


def send(port: int, request: WorstRequest, body: bytes) -> tuple[int, bytes]:
    """Send a request as raw bytes. Return status and body of the answer, or 0 if the connection ended without one."""
    headers = {"Host": "localhost", "Content-Length": str(len(body)), "Connection": "close"} | request.headers
    lines = [f"{name}: {value}".encode("latin-1") for name, value in headers.items()]
    head = request.method.encode() + b" " + request.target + b" HTTP/1.1\r\n" + b"\r\n".join(lines) + b"\r\n\r\n"
    with socket.create_connection(("127.0.0.1", port), timeout=TIMEOUT_S) as connection:
        with suppress(BrokenPipeError, ConnectionResetError):  # refused before all of it was sent
            connection.sendall(head + body)
        response = http.client.HTTPResponse(connection, method=request.method)
        try:
            response.begin()
            return response.status, response.read()
        except (OSError, http.client.HTTPException):
            return 0, b""


def probe(port: int, longest: "Synchronized[float]") -> None:
    """Ask for the liveness again and again, and note the longest time to an answer, in s."""
    request = b"GET /livez HTTP/1.1\r\nHost: localhost\r\n\r\n"
    connection = socket.create_connection(("127.0.0.1", port), timeout=TIMEOUT_S)
    while True:
        began = time.monotonic()
        connection.sendall(request)
        if not connection.recv(1 << 16):
            connection = socket.create_connection(("127.0.0.1", port), timeout=TIMEOUT_S)
            continue
        took = time.monotonic() - began
        longest.value = max(longest.value, took)
        time.sleep(max(0.0, PROBE_EVERY_S - took))


@contextmanager
def limited(mib: int | None) -> Iterator[list[str]]:
    """Yield the start of a command that runs in a control group with a limit of memory. None: no limit."""
    if mib is None:
        yield []
        return
    first = Path("/sys/fs/cgroup/memory")
    group = (first if first.is_dir() else Path("/sys/fs/cgroup")) / f"cazsl-{os.getpid()}"
    group.mkdir()
    name = "memory.limit_in_bytes" if first.is_dir() else "memory.max"
    (group / name).write_text(str(mib << 20))
    try:
        yield ["sh", "-c", f'echo $$ > {group}/cgroup.procs; exec "$@"', "sh"]
    finally:
        group.rmdir()


@contextmanager
def watched(folder: Path, source: Path, limit_mib: int | None) -> Iterator[Watched]:
    """Run a service from a source folder, and the process that watches it."""
    port = free_port()
    settings = {"CAZSL_PORT": str(port), "CAZSL_REGISTRY": str(ROOT / "models"), "CAZSL_LOG_LEVEL": "WARNING"}
    if limit_mib is not None:
        settings["CAZSL_MAX_HELD_BYTES"] = str(64 << 20)  # as in deploy/
    environment = {"PATH": os.environ["PATH"], "PYTHONPATH": str(source), **ALLOCATOR, **settings}
    longest: Synchronized[float] = multiprocessing.Value("d", 0.0)
    with limited(limit_mib) as start, (folder / "log").open("w") as log:
        process = subprocess.Popen([*start, sys.executable, *OURS], cwd=source, env=environment, stderr=log)
        prober = multiprocessing.Process(target=probe, args=(port, longest), daemon=True)
        try:
            end = time.monotonic() + TIMEOUT_S
            while not predicts(port):
                if process.poll() is not None or time.monotonic() > end:
                    raise SystemExit(f"the service does not answer:\n{(folder / 'log').read_text()[-2000:]}")
                time.sleep(0.1)
            prober.start()
            yield Watched(port, process.pid, longest)
            if process.poll() is not None:
                raise SystemExit(f"the service ended with {process.returncode}")
        finally:
            prober.kill()
            process.kill()
            process.wait()


def run(service: Watched, requests: Iterator[WorstRequest]) -> list[Outcome]:
    """Measure every request. One that misses a goal is sent again, and its best outcome counts."""
    found: list[Outcome] = []
    for request in tqdm(requests, unit=" requests"):
        best = service.measure(request)
        for _ in range(REPEATS):
            if not best.problems:
                break
            best = min(best, service.measure(request), key=lambda one: (len(one.problems), one.held_ms))
        found.append(best)
    return found


def together(service: Watched, found: list[Outcome]) -> tuple[float, list[int]]:
    """Send the requests with the largest memory at once, twice. Return the peak above the idle memory, and statuses."""
    largest = sorted(found, key=lambda one: one.peak_mib, reverse=True)[:AT_ONCE]
    Path(f"/proc/{service.pid}/clear_refs").write_text("5")
    with ThreadPoolExecutor(AT_ONCE) as clients:
        answers = clients.map(lambda one: send(service.port, one.request, one.request.body())[0], [*largest, *largest])
        statuses = list(answers)
    return service.rss_mib("VmHWM") - service.idle_mib, sorted(statuses)


def chosen(document: dict[str, Any], size: int, only: str, every: int) -> Iterator[WorstRequest]:
    """Yield the valid and the worst requests whose route and kind contain a text, and of the worst every n-th."""
    for request in valid_requests(size):
        if only in f"{request.route} {request.kind}":
            yield request
    matching = (one for one in worst_requests(document, size) if only in f"{one.route} {one.kind}")
    yield from (one for number, one in enumerate(matching) if number % every == 0)


def report(found: list[Outcome], idle_mib: float, kept_mib: float, limit_mib: int | None) -> str:
    """Return the worst rows as a page."""
    missed = [one for one in found if one.problems]
    lines = [
        "# Worst requests, measured",
        "",
        f"`python -m benchmarks.worst_requests {' '.join(sys.argv[1:])}` on {date.today()}, "
        f"Python {platform.python_version()}, {processors()} processors, load average {os.getloadavg()[1]:.1f}.",
        "Times are upper bounds: the machine is shared, and the probe waits for a processor too. Goals: held 50 ms,",
        "peak 150 MiB above idle, refusals of a few KiB.",
        "",
        f"{len(found):,} requests, of which {len(missed)} missed a goal. Idle {idle_mib:.0f} MiB; "
        f"{kept_mib:+.0f} MiB {RETURN_S:g} s after the last one."
        + (f" In a control group of {limit_mib} MiB." if limit_mib else ""),
    ]
    tables = {
        "Longest hold of the event loop": lambda one: one.held_ms,
        "Largest memory": lambda one: one.peak_mib,
        "Longest answer that refuses": lambda one: one.answer_bytes if one.status != 200 else 0,
        "Slowest": lambda one: one.took_ms,
    }
    for title, key in tables.items():
        lines += ["", f"## {title}", "", "| route | request | bytes sent | status | answer (bytes) | took (ms) "
                  "| held (ms) | peak (MiB) |", "|---|---|---|---|---|---|---|---|"]  # fmt: skip
        for one in sorted(found, key=key, reverse=True)[:SHOWN]:
            lines.append(
                f"| `{one.request.route}` | {one.request.kind} | {one.sent_bytes:,} | {one.status} "
                f"| {one.answer_bytes:,} | {one.took_ms:.0f} | {one.held_ms:.0f} | {one.peak_mib:.0f} |"
            )
    if missed:
        lines += ["", "## Missed", ""]
        lines += [f"- `{one.request.route}` {one.request.kind}: {', '.join(one.problems)}" for one in missed]
    return "\n".join(lines) + "\n"


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", type=int, default=(12 << 20) - 4096)
    parser.add_argument("--only", default="", help="requests whose route and kind contain this text")
    parser.add_argument("--every", type=int, default=1, help="of the requests that are not valid, every n-th")
    parser.add_argument("--limit-mib", type=int)
    parser.add_argument("--report", type=Path, help="page to write the worst rows to")
    parser.add_argument("--service", type=Path, default=ROOT, help="folder of the service's source")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder, watched(Path(folder), given.service, given.limit_mib) as service:
        connection = http.client.HTTPConnection("127.0.0.1", service.port)
        connection.request("GET", "/openapi.json")
        document = json.load(connection.getresponse())
        service.settle()
        found = run(service, chosen(document, given.size, given.only, given.every))
        peak_mib, statuses = together(service, found)
        time.sleep(RETURN_S)
        kept_mib = service.rss_mib("VmRSS") - service.idle_mib
        page = report(found, service.idle_mib, kept_mib, given.limit_mib)
        page += (
            f"\nThe {AT_ONCE} with the largest memory at once, twice: peak {peak_mib:.0f} MiB, statuses {statuses}.\n"
        )
    print(page)
    if given.report is not None:
        given.report.write_text(page, encoding="utf-8")
    if any(one.problems for one in found) or kept_mib > KEPT_MIB or not {0, 500}.isdisjoint(statuses):
        raise SystemExit("a goal is missed")


if __name__ == "__main__":
    main()
