"""Whether ends lose requests: SIGTERMs under load, two instances behind nginx, one restarted after the other.

    python -m benchmarks.drain [--ends 100] [--drain-s 1] [--no-retry]

wrk asks nginx without a pause while the instances are ended in turn, each as soon as the other is ready. Counted are
requests that wrk saw fail, processes that did not exit with 0, and requests that nginx had to send to the second
instance after the first had refused or closed. With ``--no-retry`` nginx may not do that for a request that it has
sent: then the time between "not ready" and "closed" (``CAZSL_DRAIN_S``) has to do alone, as behind a load balancer
that only follows readiness. nginx and wrk come with the distribution.
"""

import argparse
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from benchmarks.serving import OURS, PUSH, ROOT, Load, answers, free_port, wrk

PATIENCE_S = 60.0
CONNECTIONS = 16
NGINX = """
daemon off;
worker_processes 1;
pid {folder}/nginx.pid;
error_log {folder}/error.log;
events {{}}
http {{
  log_format asked '$status $upstream_addr';
  access_log {folder}/access.log asked buffer=64k flush=1s;
  client_body_temp_path {folder}/body; proxy_temp_path {folder}/proxy; fastcgi_temp_path {folder}/fastcgi;
  uwsgi_temp_path {folder}/uwsgi; scgi_temp_path {folder}/scgi;
  upstream cazsl {{ {servers} keepalive 32; }}
  server {{
    listen 127.0.0.1:{port};
    location / {{
      proxy_pass http://cazsl;
      proxy_http_version 1.1;
      proxy_set_header Connection "";
      proxy_next_upstream {retry};
    }}
  }}
}}
"""


class Instance:
    """A service on a port, started again and again."""

    def __init__(self, port: int, drain_s: float) -> None:
        self.port = port
        self._environment = {
            "CAZSL_PORT": str(port),
            "CAZSL_REGISTRY": str(ROOT / "models"),
            "CAZSL_DRAIN_S": str(drain_s),
            "CAZSL_LOG_LEVEL": "WARNING",
            "PATH": "/usr/bin:/bin",
            "OMP_NUM_THREADS": "1",
            "PYTHONPATH": str(ROOT),
        }
        self.start()

    def start(self) -> None:
        """Start, and wait until a prediction is answered."""
        self._process = subprocess.Popen([sys.executable, *OURS], cwd=ROOT, env=self._environment)
        end = time.monotonic() + PATIENCE_S
        while not answers(self.port):
            if self._process.poll() is not None or time.monotonic() > end:
                raise SystemExit(f"the instance on port {self.port} does not answer")
            time.sleep(0.05)

    def end(self) -> int:
        """SIGTERM, and the exit status."""
        self._process.send_signal(signal.SIGTERM)
        return self._process.wait(PATIENCE_S)

    def kill(self) -> None:
        """Whatever happens, nothing is left behind."""
        self._process.kill()
        self._process.wait()


@contextmanager
def nginx(folder: Path, instances: list[Instance], retry: bool) -> Iterator[int]:
    """Run nginx before them, on a port; its log is in the folder."""
    binary = shutil.which("nginx", path="/usr/sbin:/usr/bin:/usr/local/bin")
    if binary is None:
        raise SystemExit("nginx is not here; it comes with the distribution: apt-get install nginx-light")
    port = free_port()
    servers = " ".join(f"server 127.0.0.1:{instance.port} max_fails=0;" for instance in instances)
    words = "error timeout non_idempotent" if retry else "error timeout"
    text = NGINX.format(folder=folder, servers=servers, port=port, retry=words)
    (folder / "nginx.conf").write_text(text)
    process = subprocess.Popen([binary, "-c", str(folder / "nginx.conf"), "-p", str(folder)])
    try:
        while not answers(port):
            time.sleep(0.05)
        yield port
    finally:
        process.send_signal(signal.SIGQUIT)
        process.wait(PATIENCE_S)


def main() -> None:
    """Measure, print, and fail if anything was lost."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--ends", type=int, default=100)
    parser.add_argument("--drain-s", type=float, default=1.0)
    parser.add_argument("--no-retry", action="store_true")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        folder.chmod(0o755)
        script = Load("/v1/predict", PUSH, {"Content-Type": "application/json"}).script(folder, "push")
        instances = [Instance(free_port(), given.drain_s) for _ in range(2)]
        statuses = []
        try:
            with nginx(folder, instances, not given.no_retry) as port:
                command = wrk(script, f"http://127.0.0.1:{port}/v1/predict", CONNECTIONS, 24 * 3600)
                asking = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
                began = time.monotonic()
                for number in range(given.ends):
                    instance = instances[number % 2]
                    statuses.append(instance.end())
                    instance.start()
                asking.send_signal(signal.SIGINT)  # wrk ends in order, and says what it saw
                output, _ = asking.communicate(timeout=PATIENCE_S)
                took_s = time.monotonic() - began
        finally:
            for instance in instances:
                instance.kill()
        lines = (folder / "access.log").read_text().splitlines()
    found = re.search(r"FIGURES (\d+) (\d+) (\d+) (\d+) (\d+)", output)
    if found is None:
        raise SystemExit(f"wrk says nothing:\n{output}")
    failed, ended = int(found[5]), sum(status != 0 for status in statuses)
    refused = sum(not line.startswith(("200 ", "499 ")) for line in lines)  # 499: wrk left, at the end
    again = sum("," in line for line in lines)
    print(f"{len(statuses)} SIGTERMs in {took_s:.0f} s, drain {given.drain_s:g} s, retry {not given.no_retry}")
    print(f"requests {int(found[3])}, failed {failed}, answered otherwise by nginx {refused}, sent twice {again}")
    print(f"99th percentile {int(found[2]) / 1000:.1f} ms; processes that did not exit with 0: {ended}")
    if failed or ended:
        raise SystemExit(1)


if __name__ == "__main__":
    main()
