"""Prometheus: histograms, gauges and counters, and the text that it reads."""

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
    """Counts of values by bound, and their sum: what a histogram of Prometheus is made of."""

    __slots__ = ("_bounds", "_counts", "_total")

    def __init__(self, bounds: Sequence[float]) -> None:
        self._bounds = bounds
        self._counts = np.zeros(len(bounds) + 1, dtype=np.int64)
        self._total = 0.0

    def add(self, values: Sequence[float]) -> None:
        """Sort values into buckets."""
        places = np.searchsorted(self._bounds, values)  # the first bound that is not below
        self._counts += np.bincount(places, minlength=len(self._counts))
        self._total += sum(values)

    @property
    def total(self) -> float:
        """The sum of what was added."""
        return self._total

    def buckets(self) -> list[tuple[str, float]]:
        """Upper bounds and how many of what was added were no greater, as Prometheus has them."""
        names = (*map(repr, self._bounds), "+Inf")
        return list(zip(names, self._counts.cumsum().astype(float).tolist(), strict=True))


@dataclass(frozen=True)
class Reading:
    """A number that somebody else keeps, read when Prometheus asks: a gauge, or a counter."""

    name: str
    meaning: str
    labels: tuple[str, ...]
    read: Callable[[], Iterable[tuple[tuple[str, ...], float]]]
    counts: bool = False


class Readings(Collector):
    """Numbers that others keep."""

    def __init__(self, readings: Sequence[Reading]) -> None:
        self._readings = readings

    def collect(self) -> Iterator[Metric]:
        """The families, as they are now."""
        for reading in self._readings:
            family = _counter if reading.counts else _gauge
            yield family(reading.name, reading.meaning, reading.labels, reading.read())


def exposition(*collectors: Collector) -> CollectorRegistry:
    """What is scraped: these collectors, and memory, processor time and files of the process."""
    registry = CollectorRegistry(auto_describe=False)
    for collector in collectors:
        registry.register(collector)
    ProcessCollector(registry=registry)
    return registry


def render(registry: CollectorRegistry) -> bytes:
    """The text that Prometheus reads, in ``CONTENT_TYPE``."""
    return generate_latest(registry)


def _gauge(
    name: str, meaning: str, labels: Sequence[str], rows: Iterable[tuple[tuple[str, ...], float]]
) -> GaugeMetricFamily:
    family = GaugeMetricFamily(name, meaning, labels=labels)
    for values, number in rows:
        family.add_metric(values, number)
    return family


def _counter(
    name: str, meaning: str, labels: Sequence[str], rows: Iterable[tuple[tuple[str, ...], float]]
) -> CounterMetricFamily:
    family = CounterMetricFamily(name, meaning, labels=labels)
    for values, number in rows:
        family.add_metric(values, number)
    return family


def _histogram(
    name: str, meaning: str, labels: Sequence[str], rows: Iterable[tuple[tuple[str, ...], Distribution]]
) -> HistogramMetricFamily:
    family = HistogramMetricFamily(name, meaning, labels=labels)
    for values, found in rows:
        family.add_metric(values, found.buckets(), found.total)
    return family
