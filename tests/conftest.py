"""Options and fixtures of all tests."""

from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent


def pytest_addoption(parser: pytest.Parser) -> None:
    """Renewing a golden file takes an explicit flag."""
    parser.addoption("--renew-openapi", action="store_true", help="write openapi/openapi.json from the app")


@pytest.fixture(scope="session")
def project_root() -> Path:
    """The checkout."""
    return ROOT
