"""Instances of the service behind nginx, and wrk asking them: what drain, replicas and soak share.

Everything listens on loopback, in process groups of its own: Ctrl-C reaches the benchmark alone, which ends in order
and leaves nothing behind. nginx and wrk come with the distribution.
"""

import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from benchmarks.asking import OURS, PUSH, ROOT, Load, answers, free_port, wrk

PATIENCE_S = 60.0
CONNECTIONS = 16
PACED_CONNECTIONS = 64  # wrk waits in whole milliseconds: with few connections it would fall behind
# An instance that closes its doors admits nobody new, so whoever knocks then gets no answer: without a short
# proxy_connect_timeout, nginx waits for the kernel's second try, a second later, before it asks the other instance.
ALLOCATOR = {"MALLOC_MMAP_THRESHOLD_": "131072", "MALLOC_TRIM_THRESHOLD_": "4194304"}
"""As in the image: glibc gives back what released models held."""
ONE_PUSH = Load("/v1/predict", PUSH, {"Content-Type": "application/json"})
NGINX = """
daemon off;
worker_processes 1;
pid {folder}/nginx.pid;
error_log {folder}/error.log crit;
events {{}}
http {{
  log_format asked '$status $upstream_addr';
  map "$status $upstream_addr" $odd {{ "~^200 [^,]+$" 0; default 1; }}
  access_log {folder}/access.log asked buffer=64k flush=1s if=$odd;
  client_body_temp_path {folder}/body; proxy_temp_path {folder}/proxy; fastcgi_temp_path {folder}/fastcgi;
  uwsgi_temp_path {folder}/uwsgi; scgi_temp_path {folder}/scgi;
  client_body_buffer_size 1m; proxy_buffers 16 64k;
  upstream cazsl {{ {servers} keepalive 32; }}
  server {{
    listen 127.0.0.1:{port};
    location / {{
      proxy_pass http://cazsl;
      proxy_http_version 1.1;
      proxy_connect_timeout 100ms;
      proxy_set_header Connection "";
      proxy_next_upstream {retry};
    }}
  }}
}}
"""
# One schedule for all connections, kept by the clock: what is late is made up for, so the rate holds on average.
PACE = """
local ffi = require("ffi")
ffi.cdef("typedef struct {{ long s; long ns; }} moment; int clock_gettime(int clock, moment *now);")
local now, due = ffi.new("moment"), nil
function delay()
  ffi.C.clock_gettime(1, now)
  local at_ms = tonumber(now.s) * 1e3 + tonumber(now.ns) / 1e6
  due = (due or at_ms) + {between_ms}
  return math.max(0, due - at_ms)
end
"""


class Instance:
    """A service on a port, started again and again."""

    def __init__(self, registry: Path, log: Path, **settings: object) -> None:
        self.port = free_port()
        self.log = log
        self._environment = {
            "CAZSL_PORT": str(self.port),
            "CAZSL_REGISTRY": str(registry),
            "CAZSL_LOG_LEVEL": "WARNING",
            "PATH": "/usr/bin:/bin",
            "OMP_NUM_THREADS": "1",
            "PYTHONPATH": str(ROOT),
            **ALLOCATOR,
            **{f"CAZSL_{name.upper()}": str(value) for name, value in settings.items()},
        }
        self.start()

    @property
    def pid(self) -> int:
        """Of the process that runs, or ran last."""
        return self._process.pid

    def launch(self) -> None:
        """Start a process."""
        with self.log.open("a") as log:
            self._process = subprocess.Popen(
                [sys.executable, *OURS], cwd=ROOT, env=self._environment, stderr=log, process_group=0
            )

    def start(self) -> None:
        """Start, and wait until a prediction is answered."""
        self.launch()
        end = time.monotonic() + PATIENCE_S
        try:
            while not answers(self.port):
                if self._process.poll() is not None or time.monotonic() > end:
                    raise SystemExit(
                        f"the instance on port {self.port} does not answer; its log:\n{self._last_words()}"
                    )
                time.sleep(0.05)
        except BaseException:  # Ctrl-C too: whoever waits for this start has no instance yet to end
            self.kill()
            raise

    def _last_words(self) -> str:
        return self.log.read_text()[-2000:]

    def end(self) -> int:
        """SIGTERM, and the exit status."""
        self._process.send_signal(signal.SIGTERM)
        return self._process.wait(PATIENCE_S)

    def kill(self) -> None:
        """SIGKILL: nothing is left behind."""
        self._process.kill()
        self._process.wait()


@dataclass(frozen=True)
class Seen:
    """What one run of wrk saw."""

    p50_ms: float
    p99_ms: float
    requests: int
    took_s: float
    failed: int

    @classmethod
    def read(cls, output: str) -> "Seen":
        """Of what wrk printed."""
        found = re.search(r"FIGURES (\d+) (\d+) (\d+) (\d+) (\d+)", output)
        if found is None:
            raise SystemExit(f"wrk says nothing:\n{output}")
        p50_us, p99_us, requests, took_us, failed = map(int, found.groups())
        return cls(p50_us / 1e3, p99_us / 1e3, requests, took_us / 1e6, failed)

    @property
    def requests_per_s(self) -> float:
        """Answers per second."""
        return self.requests / self.took_s


class Asking:
    """wrk, asking without a pause, or at a rate."""

    def __init__(
        self, folder: Path, port: int, seconds: int, rate_per_s: float | None = None, load: Load = ONE_PUSH
    ) -> None:
        script = load.script(folder, load.path.replace("/", "-"))
        if rate_per_s is not None:
            script.write_text(script.read_text() + PACE.format(between_ms=1000 / rate_per_s))
        connections = CONNECTIONS if rate_per_s is None else PACED_CONNECTIONS
        command = wrk(script, f"http://127.0.0.1:{port}{load.path}", connections, seconds)
        self._process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, process_group=0)

    def running(self) -> bool:
        """Whether its time is not over."""
        return self._process.poll() is None

    def stop(self) -> None:
        """End before its time: wrk ends in order, and says what it saw."""
        self._process.send_signal(signal.SIGINT)

    def seen(self) -> Seen:
        """Wait for its end."""
        output, _ = self._process.communicate()
        return Seen.read(output)


@contextmanager
def instances(number: int, folder: Path, registry: Path, **settings: object) -> Iterator[list[Instance]]:
    """Instances over one registry, each with its log in the folder."""
    started: list[Instance] = []
    try:
        started.extend(Instance(registry, folder / f"instance-{place}.log", **settings) for place in range(number))
        yield started
    finally:
        for instance in started:
            instance.kill()


@contextmanager
def nginx(folder: Path, behind: Sequence[Instance], retry: bool = True) -> Iterator[int]:
    """Run nginx before them, on a port; what was not answered with 200 at the first instance is in its access.log."""
    binary = shutil.which("nginx", path="/usr/sbin:/usr/bin:/usr/local/bin")
    if binary is None:
        raise SystemExit("nginx is not here; it comes with the distribution: apt-get install nginx-light")
    if shutil.which("wrk") is None:
        raise SystemExit("wrk is not here; it comes with the distribution: apt-get install wrk")
    folder.mkdir(exist_ok=True)
    folder.chmod(0o755)  # nginx gives up its rights
    port = free_port()
    servers = " ".join(f"server 127.0.0.1:{instance.port} max_fails=0;" for instance in behind)
    words = "error timeout non_idempotent" if retry else "error timeout"
    (folder / "nginx.conf").write_text(NGINX.format(folder=folder, servers=servers, port=port, retry=words))
    process = subprocess.Popen([binary, "-c", str(folder / "nginx.conf"), "-p", str(folder)], process_group=0)
    try:
        while not answers(port):
            time.sleep(0.05)
        yield port
    finally:
        process.send_signal(signal.SIGQUIT)
        process.wait(PATIENCE_S)


def odd_answers(folder: Path) -> tuple[int, int]:
    """Of nginx's log: requests that were not answered with 200, and requests that were sent to a second instance."""
    lines = (folder / "access.log").read_text().splitlines()
    refused = sum(not line.startswith(("200 ", "499 ")) for line in lines)  # 499: wrk left, at the end
    return refused, sum("," in line for line in lines)


def rss_mib(pid: int) -> float:
    """Memory that a process holds."""
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20
