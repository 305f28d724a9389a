"""Server processes on loopback, and wrk as the load generator of the benchmarks of the service.

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
CLOCK_TICKS_PER_S = os.sysconf("SC_CLK_TCK")
REPORT_SCRIPT = """
done = function(summary, latency, requests)
  local failed = summary.errors.status + summary.errors.connect + summary.errors.read + summary.errors.timeout
  io.write(string.format("FIGURES %d %d %d %d %d\\n", latency:percentile(50), latency:percentile(99),
    summary.requests, summary.duration, failed))
end
"""


@dataclass(frozen=True)
class Load:
    """A request that wrk repeats: path, body and headers."""

    path: str
    body: bytes
    headers: dict[str, str]

    def script(self, folder: Path, name: str) -> Path:
        """Write the body and wrk's script into a folder, and return the script."""
        (folder / f"{name}.body").write_bytes(self.body)
        lines = [f'wrk.headers["{header}"] = "{value}"' for header, value in self.headers.items()]
        lines += ['wrk.method = "POST"', f'wrk.body = io.open("{folder / name}.body", "rb"):read("*a")', REPORT_SCRIPT]
        (folder / f"{name}.lua").write_text("\n".join(lines))
        return folder / f"{name}.lua"


@dataclass(frozen=True)
class WrkFigures:
    """Figures of one run of wrk."""

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
        """Return the processor time of the process and of its descendants, in s."""
        return sum(cpu_s(pid) for pid in descendants(self.process.pid))

    def rss_mib(self) -> float:
        """Return the resident memory of the process, in MiB."""
        return int(Path(f"/proc/{self.process.pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 2**20


def cpu_s(pid: int) -> float:
    """Return the user and system time of one process, all threads, in s."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / CLOCK_TICKS_PER_S


def descendants(pid: int) -> list[int]:
    """Return the ids of a process and of all its descendants."""
    found = [pid]
    for task in Path(f"/proc/{pid}/task").iterdir():
        for child in (task / "children").read_text().split():
            found += descendants(int(child))
    return found


@contextmanager
def server(command: list[str], port: int) -> Iterator[Server]:
    """Run a server process; yield it after its first answer, and end it with its children."""
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
            if process.poll() is None and predicts(port):
                break
            time.sleep(0.05)
        else:
            raise SystemExit(f"the server does not answer: {' '.join(command)}")
        yield Server(process, port)
    finally:
        process.terminate()
        with suppress(subprocess.TimeoutExpired):
            process.wait(10)
        with suppress(ProcessLookupError):  # some peers leave children behind, or wait for them without end
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()


def predicts(port: int) -> bool:
    """True if a prediction is answered with 200."""
    try:
        connection = http.client.HTTPConnection("127.0.0.1", port, timeout=5)
        connection.request("POST", "/v1/predict", PUSH, {"Content-Type": "application/json"})
        return connection.getresponse().status == 200
    except OSError:
        return False


def free_port() -> int:
    """Return a port without a listener."""
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        return int(listener.getsockname()[1])


def wrk_command(script: Path, url: str, connections: int, seconds: int) -> list[str]:
    """Return the command line of one run of wrk."""
    return ["wrk", "-t1", f"-c{connections}", f"-d{seconds}s", "-s", str(script), url]


def run_wrk(target: Server, script: Path, path: str, connections: int, seconds: int) -> WrkFigures:
    """Run wrk once and return its figures.

    Raises:
        SystemExit: an answer was not 200.
    """
    before = target.cpu_s()
    command = wrk_command(script, f"http://127.0.0.1:{target.port}{path}", connections, seconds)
    output = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    used = target.cpu_s() - before
    found = re.search(r"FIGURES (\d+) (\d+) (\d+) (\d+) (\d+)", output)
    if found is None or int(found[5]):
        raise SystemExit(f"wrk reports failed requests:\n{output}")
    requests = int(found[3])
    return WrkFigures(float(found[1]), float(found[2]), requests / (int(found[4]) / 1e6), used / requests * 1e6)
