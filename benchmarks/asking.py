"""Servers on loopback, each a process of its own, and wrk asking them: what the benchmarks of serving share.

wrk comes with the distribution.
"""

import http.client
import os
import re
import signal
import socket
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PUSH = b'{"pusher": {"x": -0.075, "y": 0.0, "angle": 0.0}, "context": {"descriptor": "1a2b3c4a"}}'
OURS = ["-c", "from service.cli.main import main; main()", "serve"]
TICKS = os.sysconf("SC_CLK_TCK")
REPORT = """
done = function(summary, latency, requests)
  local failed = summary.errors.status + summary.errors.connect + summary.errors.read + summary.errors.timeout
  io.write(string.format("FIGURES %d %d %d %d %d\\n", latency:percentile(50), latency:percentile(99),
    summary.requests, summary.duration, failed))
end
"""


@dataclass(frozen=True)
class Load:
    """What is asked: a path, a body and its headers."""

    path: str
    body: bytes
    headers: dict[str, str]

    def script(self, folder: Path, name: str) -> Path:
        """The script that makes wrk ask this."""
        (folder / f"{name}.body").write_bytes(self.body)
        lines = [f'wrk.headers["{header}"] = "{value}"' for header, value in self.headers.items()]
        lines += ['wrk.method = "POST"', f'wrk.body = io.open("{folder / name}.body", "rb"):read("*a")', REPORT]
        (folder / f"{name}.lua").write_text("\n".join(lines))
        return folder / f"{name}.lua"


@dataclass(frozen=True)
class Figures:
    """One run of wrk."""

    p50_us: float
    p99_us: float
    requests_per_s: float
    cpu_us: float  # of the server, per request


@dataclass(frozen=True)
class Server:
    """A server process on a port."""

    process: subprocess.Popen[bytes]
    port: int

    def cpu_s(self) -> float:
        """Processor time of the process and of all that it started."""
        return sum(cpu_s(pid) for pid in descendants(self.process.pid))

    def rss_mib(self) -> float:
        """Memory that the process holds."""
        return int(Path(f"/proc/{self.process.pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 2**20


def cpu_s(pid: int) -> float:
    """User and system time of one process, all threads."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / TICKS


def descendants(pid: int) -> list[int]:
    """A process and those that it started, and so on."""
    found = [pid]
    for task in Path(f"/proc/{pid}/task").iterdir():
        for child in (task / "children").read_text().split():
            found += descendants(int(child))
    return found


@contextmanager
def server(command: list[str], port: int) -> Iterator[Server]:
    """A server process, from its first answer to its end."""
    environment = {**os.environ, "CAZSL_PORT": str(port), "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    process = subprocess.Popen(
        command,
        cwd=ROOT,
        env=environment,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    try:
        for _ in range(1200):
            if process.poll() is None and answers(port):
                break
            time.sleep(0.05)
        else:
            raise SystemExit(f"nothing answers: {' '.join(command)}")
        yield Server(process, port)
    finally:
        process.terminate()
        with suppress(subprocess.TimeoutExpired):
            process.wait(10)
        with suppress(ProcessLookupError):  # some peers leave children behind, or wait for them for ever
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()


def answers(port: int) -> bool:
    """Whether a prediction is answered."""
    try:
        connection = http.client.HTTPConnection("127.0.0.1", port, timeout=5)
        connection.request("POST", "/v1/predict", PUSH, {"Content-Type": "application/json"})
        return connection.getresponse().status == 200
    except OSError:
        return False


def free_port() -> int:
    """A port that nobody listens on."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def wrk(script: Path, url: str, connections: int, seconds: int) -> list[str]:
    """The command that asks."""
    return ["wrk", "-t1", f"-c{connections}", f"-d{seconds}s", "-s", str(script), url]


def ask(target: Server, script: Path, path: str, connections: int, seconds: int) -> Figures:
    """One run of wrk, all answers being 200."""
    before = target.cpu_s()
    command = wrk(script, f"http://127.0.0.1:{target.port}{path}", connections, seconds)
    output = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    used = target.cpu_s() - before
    found = re.search(r"FIGURES (\d+) (\d+) (\d+) (\d+) (\d+)", output)
    if found is None or int(found[5]):
        raise SystemExit(f"wrk saw failed requests:\n{output}")
    requests = int(found[3])
    return Figures(float(found[1]), float(found[2]), requests / (int(found[4]) / 1e6), used / requests * 1e6)
