"""What Prometheus reads: how many, how long, how sure we are that models answer.

Requests are counted from their lines of the log, hundreds at a time: a request itself only keeps its line. Labels are
templates of routes, codes of problems, and names and versions of models that are served; series of versions that are
served no more are dropped, so that a registry that changes for years does not grow them. A process has its own metrics:
replicas are summed by Prometheus.
"""

from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from threading import Lock
from typing import Any, Final

from prometheus_client.metrics_core import Metric
from prometheus_client.registry import Collector

from service.observability.prometheus import Distribution, _counter, _histogram

# A single push takes 0.1 ms, ten thousand of them with images take seconds.
SECONDS: Final = (
    *(0.0001, 0.00025, 0.0005, 0.001, 0.0025, 0.005, 0.01, 0.025),
    *(0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0),
)
INFERENCE_SECONDS: Final = (0.00001, 0.000025, 0.00005, *SECONDS[:-3])
ROWS: Final = (1.0, 4.0, 16.0, 64.0, 256.0, 1024.0, 4096.0, 10_000.0)
_TOGETHER: Final = 512
Line = Mapping[str, Any]
MODEL_LABELS: Final = ("route", "model", "version")


@dataclass(frozen=True, slots=True)
class Served:
    """What one route answered by one version; neither for answers that no model gave."""

    duration_s: Distribution = field(default_factory=lambda: Distribution(SECONDS))
    inference_s: Distribution = field(default_factory=lambda: Distribution(INFERENCE_SECONDS))
    rows: Distribution = field(default_factory=lambda: Distribution(ROWS))
    statuses: Counter[int] = field(default_factory=Counter)

    def add(self, lines: Sequence[Line]) -> None:
        """Count requests."""
        self.duration_s.add(_seconds(lines, "duration_ms"))
        self.inference_s.add(_seconds(lines, "inference_ms"))
        self.rows.add([line["pushes"] for line in lines if "pushes" in line])
        self.statuses.update([line["status"] for line in lines])


class RequestMetrics(Collector):
    """Every request: its route, its model, its time and that of its parts, all from its line of the log.

    Lines are kept, as the log keeps them until it writes, and counted many at a time: one by one costs more.
    """

    def __init__(self, is_served: Callable[[str, int], bool]) -> None:
        self._is_served = is_served
        self._series: dict[tuple[str, str, int], Served] = defaultdict(Served)
        self._statuses: Counter[tuple[str, int]] = Counter()  # of series that were dropped: a counter never falls
        self._waits = {"queue_ms": Distribution(SECONDS), "decode_ms": Distribution(SECONDS)}
        self._lines: list[Line] = []
        self._counting = Lock()
        self._refusals: Counter[str] = Counter()

    def note(self, line: Line) -> None:
        """Count a request by its line of the log."""
        self._lines.append(line)
        if len(self._lines) >= _TOGETHER:
            self._count()

    def refuse(self, reason: str) -> None:
        """Count what was refused before it was a request, and leaves no line."""
        with self._counting:
            self._refusals[reason] += 1

    def collect(self) -> Iterator[Metric]:
        """The families, as they are now."""
        self._count()
        series = [((route, model, str(version or "")), found) for (route, model, version), found in self._items()]
        statuses = Counter(self._statuses)
        for (route, *_), found in series:
            statuses.update({(route, status): count for status, count in found.statuses.items()})
        yield _counter(
            "cazsl_requests",
            "Requests by route and HTTP status; 0: the client left before the answer.",
            ("route", "status"),
            (((route, str(status)), count) for (route, status), count in statuses.items()),
        )
        yield _histogram(
            "cazsl_request_duration_seconds",
            "From the head of a request to the end of its answer; the body it waits for included.",
            MODEL_LABELS,
            ((labels, found.duration_s) for labels, found in series),
        )
        by_model = [(labels, found) for labels, found in series if labels[1]]
        yield _histogram(
            "cazsl_inference_duration_seconds",
            "In the runtime, all rows of a request at once.",
            MODEL_LABELS,
            ((labels, found.inference_s) for labels, found in by_model),
        )
        yield _histogram(
            "cazsl_request_rows",
            "Pushes per answered request.",
            MODEL_LABELS,
            ((labels, found.rows) for labels, found in by_model),
        )
        yield _histogram(
            "cazsl_queue_wait_seconds",
            "How long large batches and images waited for threads, by request.",
            (),
            [((), self._waits["queue_ms"])],
        )
        yield _histogram("cazsl_image_decode_seconds", "Decoding one image.", (), [((), self._waits["decode_ms"])])
        yield _counter(
            "cazsl_refusals",
            "Requests answered by a problem, by its code.",
            ("reason",),
            (((reason,), count) for reason, count in list(self._refusals.items())),
        )

    def _count(self) -> None:
        with self._counting:  # from the event loop, or the thread of somebody who reads
            lines = self._lines[:]
            del self._lines[: len(lines)]
            self._refusals.update([line["code"] for line in lines if "code" in line])
            for name, wait in self._waits.items():
                wait.add(_seconds(lines, name))
            groups: dict[tuple[str, str, int], list[Line]] = defaultdict(list)
            for line in lines:
                groups[line["route"], line.get("model", ""), line.get("version", 0)].append(line)
            for key, group in groups.items():
                self._series[key].add(group)
            self._drop_released()  # whether or not anybody ever reads

    def _items(self) -> list[tuple[tuple[str, str, int], Served]]:
        return list(self._series.items())  # in one go: whoever reads may do so in a thread

    def _drop_released(self) -> None:
        for (route, model, version), found in self._items():
            if model and not self._is_served(model, version):
                del self._series[route, model, version]
                self._statuses.update({(route, status): count for status, count in found.statuses.items()})


def _seconds(lines: Sequence[Line], name: str) -> list[float]:
    return [line[name] / 1000.0 for line in lines if name in line]
