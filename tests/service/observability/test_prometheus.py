"""Families of Prometheus have the samples that its own parser reads."""

from collections.abc import Iterator

from service.observability.prometheus import Distribution, Reading, Readings
from tests.service.observability.scrapes import scrape, value


def test_a_value_on_a_bound_counts_in_its_bucket() -> None:
    """Buckets are cumulative, and include their upper bound."""
    found = Distribution((1.0, 2.0))
    found.add([0.5, 1.0, 1.5])
    found.add([])
    found.add([9.0])
    assert found.buckets() == [("1.0", 2.0), ("2.0", 3.0), ("+Inf", 4.0)]
    assert found.total == 12.0


def test_readings_are_read_at_each_scrape() -> None:
    """A gauge follows the value of its owner, and a counter has the suffix of Prometheus."""
    held = [1.0]

    def rows() -> Iterator[tuple[tuple[str, ...], float]]:
        yield ("a",), held[0]

    readings = Readings((Reading("held", "h", ("owner",), rows), Reading("swaps", "s", ("owner",), rows, counts=True)))
    assert value(scrape(readings), "held", owner="a") == 1.0
    held[0] = 2.0
    assert value(scrape(readings), "swaps_total", owner="a") == 2.0


def test_the_process_is_measured() -> None:
    """A scrape has the memory of the process under the name that every exporter uses."""
    assert value(scrape(), "process_resident_memory_bytes") > 0.0
