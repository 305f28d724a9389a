"""Whether ends lose requests: SIGTERMs under load, two instances behind nginx, one restarted after the other.

    python -m benchmarks.drain [--ends 100] [--drain-s 1] [--no-retry]

wrk asks nginx without a pause while the instances are ended in turn, each as soon as the other is ready. Counted are
requests that wrk saw fail, processes that did not exit with 0, and requests that nginx had to send to the second
instance after the first had refused or closed. With ``--no-retry`` nginx may not do that for a request that it has
sent: then the time between "not ready" and "closed" (``CAZSL_DRAIN_S``) has to do alone, as behind a load balancer
that only follows readiness. nginx and wrk come with the distribution.
"""

import argparse
import tempfile
from pathlib import Path

from benchmarks.asking import ROOT
from benchmarks.cluster import Asking, instances, nginx, odd_answers

A_DAY_S = 24 * 3600


def main() -> None:
    """Measure, print, and fail if anything was lost."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--ends", type=int, default=100)
    parser.add_argument("--drain-s", type=float, default=1.0)
    parser.add_argument("--no-retry", action="store_true")
    given = parser.parse_args()
    statuses = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        with (
            instances(2, folder, ROOT / "models", drain_s=given.drain_s) as both,
            nginx(folder, both, not given.no_retry) as port,
        ):
            asking = Asking(folder, port, A_DAY_S)
            try:
                for number in range(given.ends):
                    instance = both[number % 2]
                    statuses.append(instance.end())
                    instance.start()
            finally:
                asking.stop()
            seen = asking.seen()
        refused, again = odd_answers(folder)
    ended = sum(status != 0 for status in statuses)
    print(f"{len(statuses)} SIGTERMs in {seen.took_s:.0f} s, drain {given.drain_s:g} s, retry {not given.no_retry}")
    print(f"requests {seen.requests}, failed {seen.failed}, answered otherwise by nginx {refused}, sent twice {again}")
    print(f"99th percentile {seen.p99_ms:.1f} ms; processes that did not exit with 0: {ended}")
    if seen.failed or ended:
        raise SystemExit(1)


if __name__ == "__main__":
    main()
