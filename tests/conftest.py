"""Options and fixtures of all tests."""

import importlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.ray_cluster import ENVIRONMENT, TwoNodes

RAY = ("test_executors.py", "test_predict_file.py", "test_reproduction.py")  # modules that use the Ray cluster
FIRST = (*RAY, "test_bucket_storage.py")
ROOT = Path(__file__).resolve().parent.parent


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the flag that renews the golden OpenAPI document."""
    parser.addoption("--renew-openapi", action="store_true", help="write openapi/openapi.json from the app")


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """Run a module's tests in one process, and the modules that use the Ray cluster in the same one.

    Groups by mark would not do: pytest-xdist 3.8 loses them with pytest 9.2.
    """
    scheduling = importlib.import_module("xdist.scheduler").LoadScopeScheduling  # imported by name: it has no types
    return type("ModuleScheduling", (scheduling,), {"_split_scope": staticmethod(_process)})(config, log)


def _process(test: str) -> str:
    """Name the process of a test."""
    module = Path(test.partition("::")[0])
    return "ray" if module.name in RAY else str(module)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with the slowest modules, so that no process waits for one at the end."""
    items.sort(key=lambda item: FIRST.index(item.path.name) if item.path.name in FIRST else len(FIRST))


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
