"""Prometheus families of gauges, counters and histograms, and the text of a scrape."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from prometheus_client import CollectorRegistry, ProcessCollector, generate_latest
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, HistogramMetricFamily
from prometheus_client.metrics_core import Metric
from prometheus_client.registry import Collector

CONTENT_TYPE: Final = "text/plain; version=0.0.4; charset=utf-8"


class Distribution:
    """A histogram: counts of values by upper bound, and their sum."""

    __slots__ = ("_bounds", "_counts", "_total")

    def __init__(self, bounds: Sequence[float]) -> None:
        self._bounds = bounds
        self._counts = np.zeros(len(bounds) + 1, dtype=np.int64)
        self._total = 0.0

    def add(self, values: Sequence[float]) -> None:
        """Count values in their buckets."""
        places = np.searchsorted(self._bounds, values)  # the first bound that is not below
        self._counts += np.bincount(places, minlength=len(self._counts))
        self._total += sum(values)

    @property
    def total(self) -> float:
        """Return the sum of the values."""
        return self._total

    def buckets(self) -> list[tuple[str, float]]:
        """Return each upper bound with the number of values that are not greater."""
        names = (*map(repr, self._bounds), "+Inf")
        return list(zip(names, self._counts.cumsum().astype(float).tolist(), strict=True))


@dataclass(frozen=True)
class Reading:
    """A gauge or a counter that is read from its owner at every scrape."""

    name: str
    meaning: str
    labels: tuple[str, ...]
    read: Callable[[], Iterable[tuple[tuple[str, ...], float]]]
    counts: bool = False


class Readings(Collector):
    """A collector of readings."""

    def __init__(self, readings: Sequence[Reading]) -> None:
        self._readings = readings

    def collect(self) -> Iterator[Metric]:
        """Return the families with their current values."""
        for reading in self._readings:
            family = counter if reading.counts else gauge
            yield family(reading.name, reading.meaning, reading.labels, reading.read())


def exposition(*collectors: Collector) -> CollectorRegistry:
    """Register these collectors, and one of the memory, processor time and open files of the process."""
    registry = CollectorRegistry(auto_describe=False)
    for collector in collectors:
        registry.register(collector)
    ProcessCollector(registry=registry)
    return registry


def render(registry: CollectorRegistry) -> bytes:
    """Return the text of a scrape, of type ``CONTENT_TYPE``."""
    return generate_latest(registry)


def gauge(
    name: str, meaning: str, labels: Sequence[str], rows: Iterable[tuple[tuple[str, ...], float]]
) -> GaugeMetricFamily:
    """Return a family of gauges, one per row of label values."""
    family = GaugeMetricFamily(name, meaning, labels=labels)
    for values, number in rows:
        family.add_metric(values, number)
    return family


def counter(
    name: str, meaning: str, labels: Sequence[str], rows: Iterable[tuple[tuple[str, ...], float]]
) -> CounterMetricFamily:
    """Return a family of counters, one per row of label values."""
    family = CounterMetricFamily(name, meaning, labels=labels)
    for values, number in rows:
        family.add_metric(values, number)
    return family


def histogram(
    name: str, meaning: str, labels: Sequence[str], rows: Iterable[tuple[tuple[str, ...], Distribution]]
) -> HistogramMetricFamily:
    """Return a family of histograms, one per row of label values."""
    family = HistogramMetricFamily(name, meaning, labels=labels)
    for values, found in rows:
        family.add_metric(values, found.buckets(), found.total)
    return family
