"""Metrics of requests count each record by route, model and version."""

import pytest

from service.observability.metrics import RequestMetrics
from service.observability.records import RequestRecord
from service.observability.timings import Timings
from tests.service.observability.scrapes import scrape, value


def record(version: int = 1, route: str = "/v1/predict", timings: Timings | None = None) -> RequestRecord:
    """Return the record of a push that a version answered."""
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


@pytest.fixture
def metrics() -> RequestMetrics:
    """Return the metrics of a service of one model."""
    return RequestMetrics(lambda name, version: (name, version) == ("push-indicator", 1))


def test_series_of_released_versions_are_dropped_without_a_scrape() -> None:
    """Records are counted, and series of released versions dropped, long before a scrape."""
    checked: list[int] = []

    def is_served(name: str, version: int) -> bool:
        checked.append(version)
        return version == newest

    metrics = RequestMetrics(is_served)
    for newest in range(1, 1001):
        metrics.note(record(newest))
    checked.clear()
    found = scrape(metrics)
    assert min(checked) >= 512
    assert value(found, "cazsl_requests_total", route="/v1/predict", status="200") == 1000.0


def test_a_request_is_counted_by_route_model_and_version(metrics: RequestMetrics) -> None:
    """A request has a latency, an inference time, pushes and a status, and its phases have times without a model."""
    metrics.note(record(1, "/v1/predict/batch", [("queue", 0.02), ("decode", 0.2), ("inference", 0.00003)]))
    labels = {"route": "/v1/predict/batch", "model": "push-indicator", "version": "1"}
    found = scrape(metrics)
    assert value(found, "cazsl_request_duration_seconds_count", **labels) == 1.0
    assert value(found, "cazsl_request_duration_seconds_bucket", **labels, le="0.25") == 0.0
    assert value(found, "cazsl_request_duration_seconds_bucket", **labels, le="0.5") == 1.0
    assert value(found, "cazsl_inference_duration_seconds_sum", **labels) == pytest.approx(0.00003)
    assert value(found, "cazsl_request_rows_sum", **labels) == 3.0
    assert value(found, "cazsl_queue_wait_seconds_sum") == 0.02
    assert value(found, "cazsl_image_decode_seconds_sum") == 0.2
    assert value(found, "cazsl_requests_total", route="/v1/predict/batch", status="200") == 1.0


def test_refusals_are_counted_by_reason(metrics: RequestMetrics) -> None:
    """A refused request is counted by its code and by its status, and has no model."""
    metrics.note(RequestRecord("one", "POST", route="/v1/predict", code="invalid_request", status=422))
    found = scrape(metrics)
    assert value(found, "cazsl_refusals_total", reason="invalid_request") == 1.0
    assert value(found, "cazsl_requests_total", route="/v1/predict", status="422") == 1.0
    assert not any(name.startswith("cazsl_request_rows") for name, _ in found)


def test_series_of_released_versions_are_dropped_and_counts_stay(metrics: RequestMetrics) -> None:
    """A thousand released versions leave no series, and the number of requests of a route never falls."""
    for version in range(1, 1001):
        metrics.note(record(version))
    for _ in range(2):
        found = scrape(metrics)
        versions = {dict(labels).get("version") for name, labels in found if name.endswith("duration_seconds_count")}
        assert versions == {"1"}
        assert value(found, "cazsl_requests_total", route="/v1/predict", status="200") == 1000.0
