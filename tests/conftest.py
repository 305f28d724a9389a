"""Options and fixtures of all tests."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.ray_cluster import ENVIRONMENT, TwoNodes

SLOWEST = ("test_bucket_storage.py",)  # modules by their duration
ROOT = Path(__file__).resolve().parent.parent


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the flag that renews the golden OpenAPI document."""
    parser.addoption("--renew-openapi", action="store_true", help="write openapi/openapi.json from the app")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Keep the tests of a module in one process, and those of the Ray cluster too. The slowest groups begin first."""
    for item in items:
        item.add_marker(pytest.mark.xdist_group("ray" if _uses_cluster(item) else str(item.path)))
    items.sort(key=_rank)


def _uses_cluster(item: pytest.Item) -> bool:
    return "two_nodes" in getattr(item, "fixturenames", ())


def _rank(item: pytest.Item) -> int:
    """Return the place of a test's group: long groups begin first, so that no process waits for one at the end."""
    names = (*SLOWEST, item.path.name)
    return 0 if _uses_cluster(item) else 1 + names.index(item.path.name)


@pytest.fixture(scope="session")
def project_root() -> Path:
    """Return the root of the checkout."""
    return ROOT


@pytest.fixture(scope="session")
def ray_cluster() -> Iterator[TwoNodes]:
    """Run one Ray cluster for all tests of a session that need one."""
    with pytest.MonkeyPatch.context() as patch:
        for name, value in ENVIRONMENT.items():
            patch.setenv(name, value)
        cluster = TwoNodes()
        yield cluster
        cluster.close()


@pytest.fixture
def two_nodes(ray_cluster: TwoNodes) -> TwoNodes:
    """Return the Ray cluster with both its nodes. A test may kill one of them."""
    ray_cluster.complete()
    return ray_cluster
