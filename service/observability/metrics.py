"""Metrics of requests, made of their records.

Records are counted hundreds at a time, which costs less than one by one (``benchmarks/metrics.py``). Labels are
templates of routes, codes of problems, and names and versions of models that are served. Series of versions that are no
longer served are dropped, so that promotions do not grow them over the years. Each process has its own metrics, and
Prometheus sums replicas.
"""

from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from threading import Lock
from typing import Final

from prometheus_client.metrics_core import Metric
from prometheus_client.registry import Collector

from service.observability.prometheus import Distribution, counter, histogram
from service.observability.records import RequestRecord
from service.observability.timings import Phase

# A single push takes 0.1 ms, ten thousand of them with images take seconds.
SECONDS: Final = (
    *(0.0001, 0.00025, 0.0005, 0.001, 0.0025, 0.005, 0.01, 0.025),
    *(0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0),
)
INFERENCE_SECONDS: Final = (0.00001, 0.000025, 0.00005, *SECONDS[:-3])
ROWS: Final = (1.0, 4.0, 16.0, 64.0, 256.0, 1024.0, 4096.0, 10_000.0)
_TOGETHER: Final = 512
MODEL_LABELS: Final = ("route", "model", "version")
_Key = tuple[str, str, int]


@dataclass(frozen=True, slots=True)
class Series:
    """Series of one route and one version. Name and version are empty for answers without a model."""

    duration_s: Distribution = field(default_factory=lambda: Distribution(SECONDS))
    inference_s: Distribution = field(default_factory=lambda: Distribution(INFERENCE_SECONDS))
    rows: Distribution = field(default_factory=lambda: Distribution(ROWS))
    statuses: Counter[int] = field(default_factory=Counter)

    def add(self, records: Sequence[RequestRecord]) -> None:
        """Count requests."""
        self.duration_s.add([record.duration_s for record in records])
        self.inference_s.add(_seconds(records, "inference"))
        self.rows.add([record.pushes for record in records if record.model])
        self.statuses.update([record.status for record in records])


class RequestMetrics(Collector):
    """Metrics of requests: counts and durations by route, model and phase."""

    def __init__(self, is_served: Callable[[str, int], bool]) -> None:
        self._is_served = is_served
        self._series: dict[_Key, Series] = defaultdict(Series)
        self._statuses: Counter[tuple[str, int]] = Counter()  # of series that were dropped: a counter never falls
        self._phases: Mapping[Phase, Distribution] = {"queue": Distribution(SECONDS), "decode": Distribution(SECONDS)}
        self._records: list[RequestRecord] = []
        self._counting = Lock()
        self._refusals: Counter[str] = Counter()

    def note(self, record: RequestRecord) -> None:
        """Take the record of a finished request."""
        self._records.append(record)
        if len(self._records) >= _TOGETHER:
            self._count()

    def refuse(self, reason: str) -> None:
        """Count a refusal that happened before there was a request, and so has no record."""
        with self._counting:
            self._refusals[reason] += 1

    def collect(self) -> Iterator[Metric]:
        """Return the families with their current values."""
        self._count()
        series = [((route, model, str(version or "")), found) for (route, model, version), found in self._items()]
        statuses = Counter(self._statuses)
        for (route, *_), found in series:
            statuses.update({(route, status): count for status, count in found.statuses.items()})
        yield counter(
            "cazsl_requests",
            "Requests by route and HTTP status. Status 0: the client left before the answer.",
            ("route", "status"),
            (((route, str(status)), count) for (route, status), count in statuses.items()),
        )
        yield histogram(
            "cazsl_request_duration_seconds",
            "Time from the head of a request to the end of its answer, with the arrival of its body.",
            MODEL_LABELS,
            ((labels, found.duration_s) for labels, found in series),
        )
        by_model = [(labels, found) for labels, found in series if labels[1]]
        yield histogram(
            "cazsl_inference_duration_seconds",
            "Time in the runtime for all pushes of a request.",
            MODEL_LABELS,
            ((labels, found.inference_s) for labels, found in by_model),
        )
        yield histogram(
            "cazsl_request_rows",
            "Pushes per answered request.",
            MODEL_LABELS,
            ((labels, found.rows) for labels, found in by_model),
        )
        yield histogram(
            "cazsl_queue_wait_seconds",
            "Time that a large batch or an image waited for a thread.",
            (),
            [((), self._phases["queue"])],
        )
        yield histogram(
            "cazsl_image_decode_seconds",
            "Time to decode the images of a request into visual contexts.",
            (),
            [((), self._phases["decode"])],
        )
        yield counter(
            "cazsl_refusals",
            "Requests that were answered with a problem, by its code.",
            ("reason",),
            (((reason,), count) for reason, count in list(self._refusals.items())),
        )

    def _count(self) -> None:
        with self._counting:  # the event loop and the thread of a scrape call this
            records = self._records[:]
            del self._records[: len(records)]
            self._refusals.update([record.code for record in records if record.code])
            for phase, distribution in self._phases.items():
                distribution.add(_seconds(records, phase))
            groups: dict[_Key, list[RequestRecord]] = defaultdict(list)
            for record in records:
                groups[record.route, record.model, record.version].append(record)
            for key, group in groups.items():
                self._series[key].add(group)
            self._drop_released()  # here, since Prometheus may never read

    def _items(self) -> list[tuple[_Key, Series]]:
        return list(self._series.items())  # a copy in one call: a scrape reads in a thread

    def _drop_released(self) -> None:
        for (route, model, version), found in self._items():
            if model and not self._is_served(model, version):
                del self._series[route, model, version]
                self._statuses.update({(route, status): count for status, count in found.statuses.items()})


def _seconds(records: Sequence[RequestRecord], phase: Phase) -> list[float]:
    """Return the seconds that a phase took in each request that had it."""
    found = ([seconds for name, seconds in record.timings if name == phase] for record in records)
    return [sum(seconds) for seconds in found if seconds]
