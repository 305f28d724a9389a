"""Requests lost at shutdown: SIGTERMs under load, two instances behind nginx, one restarted after the other.

    python -m benchmarks.drain [--ends 100] [--drain-s 1] [--no-retry]

wrk sends requests to nginx without a pause while the instances are ended in turn, each as soon as the other is ready.
The benchmark counts failed requests, processes that did not exit with 0, and requests that nginx sent to the second
instance after the first had refused or closed. With ``--no-retry`` nginx may not resend a request that it has sent.
Then the time between "not ready" and "closed" (``CAZSL_DRAIN_S``) must be enough, as behind a load balancer that only
follows readiness. nginx and wrk come with the distribution.
"""

import argparse
import tempfile
from pathlib import Path

from benchmarks.cluster import WrkProcess, count_refused_and_retried, instances, nginx
from benchmarks.http_load import ROOT

A_DAY_S = 24 * 3600


def main() -> None:
    """Measure and print. Fail if a request was lost or a process did not exit with 0."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--ends", type=int, default=100)
    parser.add_argument("--drain-s", type=float, default=1.0)
    parser.add_argument("--no-retry", action="store_true")
    options = parser.parse_args()
    statuses = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        with (
            instances(2, folder, ROOT / "models", drain_s=options.drain_s) as both,
            nginx(folder, both, not options.no_retry) as port,
        ):
            wrk_run = WrkProcess(folder, port, A_DAY_S)
            try:
                for number in range(options.ends):
                    instance = both[number % 2]
                    statuses.append(instance.end())
                    instance.start()
            finally:
                wrk_run.stop()
            report = wrk_run.report()
        refused, again = count_refused_and_retried(folder)
    ended = sum(status != 0 for status in statuses)
    print(
        f"{len(statuses)} SIGTERMs in {report.took_s:.0f} s, drain {options.drain_s:g} s, retry {not options.no_retry}"
    )
    print(
        f"requests {report.requests}, failed {report.failed}, answered otherwise by nginx {refused}, sent twice {again}"
    )
    print(f"99th percentile {report.p99_ms:.1f} ms; processes that did not exit with 0: {ended}")
    if report.failed or ended:
        raise SystemExit(1)


if __name__ == "__main__":
    main()
