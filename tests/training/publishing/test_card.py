"""The model card: its data and its figures."""

import pytest

from service.model.tensors import ContextKind
from service.registry.registry import Registry
from tests.training.publishing.published_graphs import KINDS
from training.omnipush.pushes import Pushes


@pytest.mark.parametrize("kind", KINDS)
def test_the_card_names_its_data_and_figures(
    registry: Registry, data: dict[ContextKind, Pushes], kind: ContextKind
) -> None:
    """The card names the source and digest of its data, its held-out figures, and the range of its pushes."""
    pushes, version = data[kind], registry.read(f"push-{kind}", 1)
    metrics = version.manifest.metrics["different-objects"]

    assert f"Trained on **{pushes.source}**: 200 objects" in version.card
    assert pushes.digest in version.card
    assert f"| {metrics.rmse:.4f} | {metrics.std:.4f} | {metrics.distance_mm:.2f} | {metrics.nll:.3f} |" in version.card
    assert "| start 75 to 90 mm | " in version.card
    assert "| start_distance_m | 0.08 | 0.08 |" in version.card
    assert f"times {version.manifest.calibration['different-objects'].scale:.3f}" in version.card
