"""Fixtures of the fitting tests: the synthetic pushes of all objects."""

from pathlib import Path

import pytest

from training.omnipush.pushes import Pushes, read_folder


@pytest.fixture(scope="session")
def pushes(data_folder: Path) -> Pushes:
    """Read the synthetic pushes of all 250 objects."""
    return read_folder(data_folder)
