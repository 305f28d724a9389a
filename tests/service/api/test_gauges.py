"""Gauges and counters have the names that dashboards and alerts use."""

import re
from pathlib import Path

from service.app import create_app
from service.inference.loaded_models import LoadedModels
from service.observability.prometheus import render
from service.registry.registry import Registry
from service.settings import Settings
from tests.fakes import BROKEN, fake_models, load_fake, publish_fake


def scrape(models: LoadedModels) -> str:
    """Return the text of a scrape of a service over these models."""
    return render(create_app(Settings(), models).parts.metrics).decode()


def test_loads_swaps_releases_and_failures_are_counted(tmp_path: Path) -> None:
    """A new champion is a load and a swap, a broken version a failure at each poll, and an old version a release."""
    registry, _ = fake_models(tmp_path / "models")
    models = LoadedModels(registry, load_fake, newest_versions=1)
    models.refresh()
    publish_fake(registry)
    models.refresh()
    publish_fake(registry, model=BROKEN)
    models.refresh()
    text = scrape(models)
    for line in (
        'cazsl_model_loads_total{model="push-indicator"} 2.0',
        'cazsl_model_releases_total{model="push-indicator"} 1.0',
        'cazsl_model_load_failures_total{model="push-indicator"} 1.0',
        'cazsl_alias_swaps_total{alias="champion",model="push-indicator"} 1.0',
        'cazsl_alias_version{alias="champion",model="push-indicator"} 2.0',
        "cazsl_registry_up 1.0",
        "cazsl_registry_problems 2.0",
    ):
        assert f"\n{line}\n" in text


def test_a_registry_that_cannot_be_read_is_down_and_counted(tmp_path: Path) -> None:
    """Gauges and counters that alerts use show a registry that cannot be read."""
    models = LoadedModels(Registry(tmp_path / "gone"), load_fake)
    for _ in range(3):
        models.refresh()
    text = scrape(models)
    assert "\ncazsl_registry_up 0.0\n" in text
    assert "\ncazsl_registry_failures_total 3.0\n" in text
    assert "\ncazsl_ready 0.0\n" in text


def test_the_documentation_lists_every_metric(tmp_path: Path, project_root: Path) -> None:
    """docs/operations.md lists exactly the metrics of the service, with their meanings."""
    text = scrape(fake_models(tmp_path / "models")[1])
    real = set(re.findall(r"^# TYPE (cazsl_\w+) ", text, re.MULTILINE))
    listed = (project_root / "docs" / "operations.md").read_text(encoding="utf-8")
    assert set(re.findall(r"^\| `(cazsl_\w+)` \|", listed, re.MULTILINE)) == real
    for name, meaning in re.findall(r"^# HELP (cazsl_\w+) (.*)$", text, re.MULTILINE):
        assert re.search(rf"^\| `{name}` \| .* \| {re.escape(meaning)} \|$", listed, re.MULTILINE), name
