"""Fixtures of the publishing tests: finished runs of each kind of context, published in a registry."""

from pathlib import Path

import pytest

from service.model.tensors import ContextKind
from service.registry.registry import Registry
from tests.training.publishing.published_graphs import KINDS, load_push_network
from training.fitting.run_folder import load_run
from training.networks.omnipush_domain import OmnipushDomain
from training.networks.push_network import PushNetwork
from training.omnipush.pushes import Pushes, read_folder
from training.publishing.publish import domain_of, publish


@pytest.fixture(scope="session")
def pushes(data_folder: Path) -> Pushes:
    """Read the synthetic pushes of all 250 objects."""
    return read_folder(data_folder)


@pytest.fixture(scope="session")
def data(pushes: Pushes, viewed_pushes: Pushes) -> dict[ContextKind, Pushes]:
    """Return the pushes that each kind was fitted to."""
    return {kind: viewed_pushes if kind is ContextKind.VISUAL else pushes for kind in KINDS}


@pytest.fixture(scope="session")
def runs(indicator_run: Path, none_run: Path, visual_run: Path) -> dict[ContextKind, Path]:
    """Return the finished run of each kind."""
    return {ContextKind.INDICATOR: indicator_run, ContextKind.NONE: none_run, ContextKind.VISUAL: visual_run}


@pytest.fixture(scope="session")
def networks(runs: dict[ContextKind, Path]) -> dict[ContextKind, PushNetwork]:
    """Load the fitted network of each kind."""
    return {kind: load_push_network(run) for kind, run in runs.items()}


@pytest.fixture(scope="session")
def registry(
    tmp_path_factory: pytest.TempPathFactory, data: dict[ContextKind, Pushes], runs: dict[ContextKind, Path]
) -> Registry:
    """Publish the indicator model twice and the others once. Tests must not change this registry."""
    found = Registry(tmp_path_factory.mktemp("registry") / "models")
    for kind in (ContextKind.INDICATOR, *runs):
        recipe, network, _ = load_run(runs[kind])
        publish(recipe, network, data[kind], found, "noise of a test" if kind is ContextKind.VISUAL else None)
    return found


@pytest.fixture(scope="session")
def graphs(registry: Registry) -> dict[ContextKind, bytes]:
    """Read the published graph of each kind."""
    return {kind: registry.read(f"push-{kind}", 1).model for kind in KINDS}


@pytest.fixture(scope="session")
def domains(data: dict[ContextKind, Pushes], runs: dict[ContextKind, Path]) -> dict[ContextKind, OmnipushDomain]:
    """Return the domain of each kind's training pushes."""
    return {kind: domain_of(data[kind].select(load_run(run)[0].split().train), kind) for kind, run in runs.items()}


@pytest.fixture(scope="session")
def scales(registry: Registry) -> dict[ContextKind, float]:
    """Return the factor of the deviations that each published graph has inside."""
    found = {}
    for kind in KINDS:
        calibration = registry.read(f"push-{kind}", 1).manifest.calibration["different-objects"]
        assert calibration.scale is not None
        found[kind] = calibration.scale
    return found
