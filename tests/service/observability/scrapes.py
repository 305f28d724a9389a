"""Scrapes of metrics, as the parser of Prometheus reads them."""

from prometheus_client.parser import text_string_to_metric_families
from prometheus_client.registry import Collector

from service.observability.prometheus import exposition, render

Samples = dict[tuple[str, frozenset[tuple[str, str]]], float]


def scrape(*collectors: Collector) -> Samples:
    """Return every sample of these collectors, by name and labels."""
    text = render(exposition(*collectors)).decode()
    return {
        (sample.name, frozenset(sample.labels.items())): sample.value
        for family in text_string_to_metric_families(text)
        for sample in family.samples
    }


def value(found: Samples, name: str, **labels: str) -> float:
    """Return the value of one sample.

    Raises:
        KeyError: there is none.
    """
    return found[name, frozenset(labels.items())]
