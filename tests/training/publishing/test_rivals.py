"""Rivals: published versions measured on other data than their own."""

import numpy as np
import pytest

from service.model.predictor import OnnxPredictor
from service.model.tensors import ContextKind
from service.registry.loading import load_version
from service.registry.registry import Registry
from tests.training.publishing.published_graphs import KINDS
from training.fitting.bands import conformal_factor
from training.fitting.evaluation import predictions
from training.fitting.samples import Samples
from training.networks.push_network import PushNetwork
from training.omnipush.published import different_objects
from training.omnipush.pushes import Pushes
from training.publishing.rivals import predicted, rivals_of


@pytest.mark.parametrize("kind", KINDS)
def test_a_published_graph_predicts_what_its_network_does(
    registry: Registry, networks: dict[ContextKind, PushNetwork], data: dict[ContextKind, Pushes], kind: ContextKind
) -> None:
    """The normalised predictions of a graph are those of the network, with every std times the published scale."""
    name, pushes = f"push-{kind}", data[kind].select(data[kind].descriptors[:4])
    samples = Samples.of(pushes, kind)
    version = load_version(registry, OnnxPredictor, name, 1)
    scale = version.manifest.calibration["different-objects"].scale
    assert scale is not None

    found, expected = predicted(version.predictor, samples), predictions(networks[kind], samples).scaled(scale)

    assert found.mean == pytest.approx(expected.mean, abs=1e-3)
    assert found.log_std == pytest.approx(expected.log_std, abs=1e-3)
    assert np.array_equal(found.objects, expected.objects)
    assert conformal_factor(found) == pytest.approx(conformal_factor(expected), rel=1e-3)


def test_a_model_without_aliases_has_no_rivals(registry: Registry, pushes: Pushes) -> None:
    """Versions that no alias names are not measured."""
    samples = Samples.of(pushes.select(pushes.descriptors[:2]), ContextKind.NONE)

    assert rivals_of(registry, "push-none", different_objects(), samples) is None
