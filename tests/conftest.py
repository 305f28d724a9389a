"""Options and fixtures of all tests."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.ray_cluster import ENVIRONMENT, TwoNodes

ROOT = Path(__file__).resolve().parent.parent


def pytest_addoption(parser: pytest.Parser) -> None:
    """Renewing a golden file takes an explicit flag."""
    parser.addoption("--renew-openapi", action="store_true", help="write openapi/openapi.json from the app")


@pytest.fixture(scope="session")
def project_root() -> Path:
    """The checkout."""
    return ROOT


@pytest.fixture(scope="session")
def ray_cluster() -> Iterator[TwoNodes]:
    """A Ray cluster for all tests that want one."""
    with pytest.MonkeyPatch.context() as patch:
        for name, value in ENVIRONMENT.items():
            patch.setenv(name, value)
        cluster = TwoNodes()
        yield cluster
        cluster.close()


@pytest.fixture
def two_nodes(ray_cluster: TwoNodes) -> TwoNodes:
    """That cluster with both its nodes; a test may kill one."""
    ray_cluster.complete()
    return ray_cluster
