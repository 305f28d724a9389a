"""A registry for the tests of commands."""

from pathlib import Path

import pytest

from service.registry.registry import Registry
from tests.service.cli.command_line import NAME


@pytest.fixture
def root(project_root: Path, tmp_path: Path) -> Path:
    """A registry with the first shipped version twice: 1, the champion, and 2. It does not pass the physics gates."""
    first = Registry(project_root / "models").read(NAME, 1)
    registry = Registry(tmp_path / "models")
    for _ in range(2):
        registry.publish(first.manifest, first.model, first.card)
    registry.point_alias(NAME, "champion", 1)
    return tmp_path / "models"
