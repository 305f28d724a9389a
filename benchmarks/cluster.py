"""Instances of the service behind nginx, with wrk as the load generator: shared by drain, replicas and soak.

All processes listen on loopback and have process groups of their own, so Ctrl-C reaches the benchmark alone, which then
ends them in order. nginx and wrk come with the distribution.
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

from benchmarks.http_load import OURS, PUSH, ROOT, Load, free_port, predicts, wrk_command

TIMEOUT_S = 60.0
CONNECTIONS = 16
PACED_CONNECTIONS = 64  # wrk waits in whole milliseconds, so few connections would not reach the rate
# An instance that closes its sockets does not answer new connections. Without a short proxy_connect_timeout, nginx
# waits for the kernel's second try, a second later, before it asks the other instance.
ALLOCATOR = {"MALLOC_MMAP_THRESHOLD_": "131072", "MALLOC_TRIM_THRESHOLD_": "4194304"}
"""As in the image: glibc returns the memory of released models."""
ONE_PUSH = Load("/v1/predict", PUSH, {"Content-Type": "application/json"})
NGINX = """
daemon off;
worker_processes 1;
pid {folder}/nginx.pid;
error_log {folder}/error.log crit;
events {{}}
http {{
  log_format asked '$status $upstream_addr';
  map "$status $upstream_addr" $unusual {{ "~^200 [^,]+$" 0; default 1; }}
  access_log {folder}/access.log asked buffer=64k flush=1s if=$unusual;
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
# One schedule for all connections, by the clock. Late requests are caught up, so the rate holds on average.
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
    """An instance of the service on a port, which can be ended and started again."""

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
        """The id of the process that runs, or ran last."""
        return self._process.pid

    def launch(self) -> None:
        """Start a process."""
        with self.log.open("a") as log:
            self._process = subprocess.Popen(
                [sys.executable, *OURS], cwd=ROOT, env=self._environment, stderr=log, process_group=0
            )

    def start(self) -> None:
        """Start a process and wait until it predicts.

        Raises:
            SystemExit: the process ended, or did not predict in time.
        """
        self.launch()
        end = time.monotonic() + TIMEOUT_S
        try:
            while not predicts(self.port):
                if self._process.poll() is not None or time.monotonic() > end:
                    raise SystemExit(f"the instance on port {self.port} does not answer; its log:\n{self._log_tail()}")
                time.sleep(0.05)
        except BaseException:  # Ctrl-C too: the caller has no instance yet to end
            self.kill()
            raise

    def _log_tail(self) -> str:
        return self.log.read_text()[-2000:]

    def end(self) -> int:
        """End the process by SIGTERM and return its exit status."""
        self._process.send_signal(signal.SIGTERM)
        return self._process.wait(TIMEOUT_S)

    def kill(self) -> None:
        """End the process by SIGKILL and wait for it."""
        self._process.kill()
        self._process.wait()


@dataclass(frozen=True)
class WrkReport:
    """A report of one run of wrk."""

    p50_ms: float
    p99_ms: float
    requests: int
    took_s: float
    failed: int

    @classmethod
    def read(cls, output: str) -> "WrkReport":
        """Read the report that wrk printed."""
        found = re.search(r"FIGURES (\d+) (\d+) (\d+) (\d+) (\d+)", output)
        if found is None:
            raise SystemExit(f"wrk printed no figures:\n{output}")
        p50_us, p99_us, requests, took_us, failed = map(int, found.groups())
        return cls(p50_us / 1e3, p99_us / 1e3, requests, took_us / 1e6, failed)

    @property
    def requests_per_s(self) -> float:
        """Return the answers per second."""
        return self.requests / self.took_s


class WrkProcess:
    """A process of wrk that sends requests without a pause, or at a rate."""

    def __init__(
        self, folder: Path, port: int, seconds: int, rate_per_s: float | None = None, load: Load = ONE_PUSH
    ) -> None:
        script = load.script(folder, load.path.replace("/", "-"))
        if rate_per_s is not None:
            script.write_text(script.read_text() + PACE.format(between_ms=1000 / rate_per_s))
        connections = CONNECTIONS if rate_per_s is None else PACED_CONNECTIONS
        command = wrk_command(script, f"http://127.0.0.1:{port}{load.path}", connections, seconds)
        self._process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, process_group=0)

    def running(self) -> bool:
        """True while the process runs."""
        return self._process.poll() is None

    def stop(self) -> None:
        """End the run early. wrk ends in order and prints its report."""
        self._process.send_signal(signal.SIGINT)

    def report(self) -> WrkReport:
        """Wait for the end of the run and return its report."""
        output, _ = self._process.communicate()
        return WrkReport.read(output)


@contextmanager
def instances(number: int, folder: Path, registry: Path, **settings: object) -> Iterator[list[Instance]]:
    """Run instances over one registry, each with its log in the folder."""
    started: list[Instance] = []
    try:
        started.extend(Instance(registry, folder / f"instance-{place}.log", **settings) for place in range(number))
        yield started
    finally:
        for instance in started:
            instance.kill()


@contextmanager
def nginx(folder: Path, upstreams: Sequence[Instance], retry: bool = True) -> Iterator[int]:
    """Run nginx before the instances and yield its port.

    access.log in the folder lists the requests without a 200 from the first instance.
    """
    binary = shutil.which("nginx", path="/usr/sbin:/usr/bin:/usr/local/bin")
    if binary is None:
        raise SystemExit("nginx is not installed: apt-get install nginx-light")
    if shutil.which("wrk") is None:
        raise SystemExit("wrk is not installed: apt-get install wrk")
    folder.mkdir(exist_ok=True)
    folder.chmod(0o755)  # nginx drops its rights
    port = free_port()
    servers = " ".join(f"server 127.0.0.1:{instance.port} max_fails=0;" for instance in upstreams)
    conditions = "error timeout non_idempotent" if retry else "error timeout"
    (folder / "nginx.conf").write_text(NGINX.format(folder=folder, servers=servers, port=port, retry=conditions))
    process = subprocess.Popen([binary, "-c", str(folder / "nginx.conf"), "-p", str(folder)], process_group=0)
    try:
        while not predicts(port):
            time.sleep(0.05)
        yield port
    finally:
        process.send_signal(signal.SIGQUIT)
        process.wait(TIMEOUT_S)


def count_refused_and_retried(folder: Path) -> tuple[int, int]:
    """Count in nginx's log the requests without a 200, and the requests that were sent to a second instance."""
    lines = (folder / "access.log").read_text().splitlines()
    # 499: wrk closed the connection at the end of its run
    refused = sum(not line.startswith(("200 ", "499 ")) for line in lines)
    return refused, sum("," in line for line in lines)


def rss_mib(pid: int) -> float:
    """Return the resident memory of a process, in MiB."""
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20
