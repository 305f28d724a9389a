"""What happened to models since the start."""

from pathlib import Path

from service.inference.loaded_models import LoadedModels
from service.registry.registry import Registry
from tests.fakes import fake_models, load_fake, publish_fake


def test_an_alias_that_is_new_is_a_load_and_no_swap(tmp_path: Path) -> None:
    """A swap is a change of what was served; looking twice counts nothing twice."""
    registry, models = fake_models(tmp_path / "models")
    models.refresh()
    assert (models.tally.loads["push-indicator"], models.tally.swaps["push-indicator", "champion"]) == (1, 0)
    publish_fake(registry)
    models.refresh()
    models.refresh()
    assert (models.tally.loads["push-indicator"], models.tally.swaps["push-indicator", "champion"]) == (2, 1)


def test_a_registry_is_down_until_it_is_seen(tmp_path: Path) -> None:
    """And up again as soon as it is."""
    models = LoadedModels(Registry(tmp_path / "models"), load_fake)
    models.refresh()
    assert (models.tally.registry_up, models.tally.registry_failures) == (False, 1)
    publish_fake(Registry(tmp_path / "models"))
    models.refresh()
    assert (models.tally.registry_up, models.tally.registry_failures) == (True, 1)
