"""The record of a request is attached to its scope, and renders its log line."""

from datetime import UTC, datetime
from typing import Any

from service.observability.records import UNKNOWN_ROUTE, RequestRecord, attach_record, record_of

TIME = datetime(2026, 11, 28, tzinfo=UTC)


def test_a_record_is_found_in_the_scope_of_its_request() -> None:
    """A record is attached to the state of a scope, beside the state that is there already."""
    record = RequestRecord("one", "POST")
    for scope in ({}, {"state": {"other": 1}}):
        found: dict[str, Any] = scope
        attach_record(found, record)
        assert record_of(found) is record
    assert found["state"]["other"] == 1


def test_a_request_without_a_model_has_the_short_line() -> None:
    """A line has no field of a prediction, a problem or a trace that did not occur."""
    record = RequestRecord("one", "GET", status=200, duration_s=0.0123456789, time=TIME)
    assert record.line() == {
        "time": TIME,
        "request_id": "one",
        "method": "GET",
        "route": UNKNOWN_ROUTE,
        "status": 200,
        "duration_ms": 12.3457,
    }


def test_a_line_has_the_sum_of_each_phase() -> None:
    """A request with several images has one decode time: their sum, in ms."""
    record = RequestRecord("one", "POST", timings=[("decode", 0.001), ("inference", 0.0001), ("decode", 0.002)])
    line = record.line()
    assert (line["decode_ms"], line["inference_ms"]) == (3.0, 0.1)
    assert "queue_ms" not in line


def test_a_line_has_the_model_the_code_and_the_trace() -> None:
    """A line names the model of a prediction, the code of a problem, and the trace of the caller."""
    record = RequestRecord("one", "POST", trace=("t", "s"), code="prediction", model="push-none", version=2, pushes=3)
    line = record.line()
    assert (line["trace_id"], line["span_id"], line["code"]) == ("t", "s", "prediction")
    assert (line["model"], line["version"], line["pushes"]) == ("push-none", 2, 3)
