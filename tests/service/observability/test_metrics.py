"""What Prometheus reads, as its own parser reads it."""

from collections.abc import Iterator

import pytest
from prometheus_client.parser import text_string_to_metric_families

from service.observability.metrics import RequestMetrics
from service.observability.prometheus import Distribution, Reading, Readings, exposition, render
from service.observability.records import RequestRecord
from service.observability.timings import Timings


def record(version: int = 1, route: str = "/v1/predict", timings: Timings | None = None) -> RequestRecord:
    """A push that was answered by a version."""
    return RequestRecord(
        "one",
        "POST",
        route=route,
        model="push-indicator",
        version=version,
        pushes=3,
        timings=timings or [],
        status=200,
        duration_s=0.3,
    )


def scraped(*collectors: RequestMetrics | Readings) -> dict[tuple[str, frozenset[tuple[str, str]]], float]:
    """Every sample by name and labels."""
    text = render(exposition(*collectors)).decode()
    return {
        (sample.name, frozenset(sample.labels.items())): sample.value
        for family in text_string_to_metric_families(text)
        for sample in family.samples
    }


def sample(found: dict[tuple[str, frozenset[tuple[str, str]]], float], name: str, **labels: str) -> float:
    """One of them; KeyError when it is not there."""
    return found[name, frozenset(labels.items())]


@pytest.fixture
def metrics() -> RequestMetrics:
    """Metrics of a service of one model."""
    return RequestMetrics(lambda name, version: (name, version) == ("push-indicator", 1))


def test_versions_leave_no_series_behind_where_nobody_reads() -> None:
    """Most were counted and dropped long before somebody reads at last."""
    asked: list[int] = []

    def is_served(name: str, version: int) -> bool:
        asked.append(version)
        return version == newest

    metrics = RequestMetrics(is_served)
    for newest in range(1, 1001):
        metrics.note(record(newest))
    asked.clear()
    found = scraped(metrics)
    assert min(asked) >= 512
    assert sample(found, "cazsl_requests_total", route="/v1/predict", status="200") == 1000.0


def test_a_value_on_a_bound_counts_below_it() -> None:
    """Prometheus's buckets are cumulative and closed above."""
    found = Distribution((1.0, 2.0))
    found.add([0.5, 1.0, 1.5])
    found.add([])
    found.add([9.0])
    assert found.buckets() == [("1.0", 2.0), ("2.0", 3.0), ("+Inf", 4.0)]
    assert found.total == 12.0


def test_a_request_is_counted_by_route_model_and_version(metrics: RequestMetrics) -> None:
    """Latency, inference, rows and status; the parts that have no model by themselves."""
    metrics.note(record(1, "/v1/predict/batch", [("queue", 0.02), ("decode", 0.2), ("inference", 0.00003)]))
    labels = {"route": "/v1/predict/batch", "model": "push-indicator", "version": "1"}
    found = scraped(metrics)
    assert sample(found, "cazsl_request_duration_seconds_count", **labels) == 1.0
    assert sample(found, "cazsl_request_duration_seconds_bucket", **labels, le="0.25") == 0.0
    assert sample(found, "cazsl_request_duration_seconds_bucket", **labels, le="0.5") == 1.0
    assert sample(found, "cazsl_inference_duration_seconds_sum", **labels) == pytest.approx(0.00003)
    assert sample(found, "cazsl_request_rows_sum", **labels) == 3.0
    assert sample(found, "cazsl_queue_wait_seconds_sum") == 0.02
    assert sample(found, "cazsl_image_decode_seconds_sum") == 0.2
    assert sample(found, "cazsl_requests_total", route="/v1/predict/batch", status="200") == 1.0


def test_refusals_are_counted_by_reason(metrics: RequestMetrics) -> None:
    """The code of the problem, and the status under the route; no model has answered."""
    metrics.note(RequestRecord("one", "POST", route="/v1/predict", code="invalid_request", status=422))
    found = scraped(metrics)
    assert sample(found, "cazsl_refusals_total", reason="invalid_request") == 1.0
    assert sample(found, "cazsl_requests_total", route="/v1/predict", status="422") == 1.0
    assert not any(name.startswith("cazsl_request_rows") for name, _ in found)


def test_versions_that_are_served_no_more_leave_no_series_and_take_no_count_with_them(metrics: RequestMetrics) -> None:
    """A thousand versions in a year leave none behind; requests by route never fall."""
    for version in range(1, 1001):
        metrics.note(record(version))
    for _ in range(2):
        found = scraped(metrics)
        versions = {dict(labels).get("version") for name, labels in found if name.endswith("duration_seconds_count")}
        assert versions == {"1"}
        assert sample(found, "cazsl_requests_total", route="/v1/predict", status="200") == 1000.0


def test_what_others_keep_is_read_when_somebody_asks() -> None:
    """A gauge follows, a counter has its suffix."""
    held = [1.0]

    def rows() -> Iterator[tuple[tuple[str, ...], float]]:
        yield ("a",), held[0]

    readings = Readings((Reading("held", "h", ("who",), rows), Reading("seen", "s", ("who",), rows, counts=True)))
    assert sample(scraped(readings), "held", who="a") == 1.0
    held[0] = 2.0
    assert sample(scraped(readings), "seen_total", who="a") == 2.0


def test_the_process_is_measured_too(metrics: RequestMetrics) -> None:
    """Memory and open files, as every exporter names them."""
    assert sample(scraped(metrics), "process_resident_memory_bytes") > 0.0
