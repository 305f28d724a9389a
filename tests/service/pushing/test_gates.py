"""What a version must show before an alias may name it."""

import math
from dataclasses import dataclass, replace

import numpy as np
import pytest

from service.model.domain import Verdict
from service.model.loaded_model import LoadedModel
from service.model.manifest import Manifest
from service.model.tensors import ContextKind, FloatArray, IndexArray
from service.pushing.contexts import BITS_PER_SIDE, SIDES
from service.pushing.gates import physics_gates
from tests.fakes import draft_manifest


@dataclass
class Physics:
    """Objects that move 10 mm away from a pusher that comes at them, a little more for each side of shape 1 it faces.

    Each flaw breaks one law.
    """

    flaw: str = ""

    def predict(
        self, pusher: FloatArray, context: FloatArray | None, context_index: IndexArray | None
    ) -> tuple[FloatArray, FloatArray]:
        """See ``service.model.predictor.Predictor``."""
        x, y, angle = pusher.astype(np.float64).T
        touches = (x * np.cos(angle) + y * np.sin(angle)) < 0.0
        if self.flaw == "no-contact":
            touches[:] = True
        way = 0.010 * touches
        if context is not None and context_index is not None and context.shape[-1] == SIDES * BITS_PER_SIDE:
            concave = context.reshape(len(context), SIDES, BITS_PER_SIDE)[context_index, :, 0]
            facing = np.arctan2(y, x)[:, None] - np.arange(SIDES) * math.pi / 2.0
            way = way * (1.0 + (concave * np.maximum(np.cos(facing), 0.0)).sum(axis=1))
        if self.flaw == "angle-at-pi":
            way = way * np.where(angle > 0.0, 3.0, 1.0)
        mean = np.column_stack([way * np.cos(angle), way * np.sin(angle), np.zeros(len(x))])
        if self.flaw == "turned":
            mean[:, 0] *= 2.0
        return mean.astype(np.float32), np.full((len(x), 3), 1e-3, dtype=np.float32)


def model(flaw: str = "", kind: ContextKind = ContextKind.INDICATOR, manifest: Manifest | None = None) -> LoadedModel:
    """A loaded model with honest statistics and an RMSE of a twentieth of a deviation."""
    found = manifest or draft_manifest(kind=kind)
    metrics = {name: replace(figures, rmse=0.05) for name, figures in found.metrics.items()}
    normalisation = replace(found.normalisation, output_std=[0.0154, 0.0156, 0.215])
    return LoadedModel(replace(found, metrics=metrics, normalisation=normalisation), "", Physics(flaw))


def refused(verdicts: list[Verdict]) -> list[str]:
    """The gates that refused."""
    return [verdict.gate for verdict in verdicts if not verdict.passed]


@pytest.mark.parametrize("kind", [ContextKind.NONE, ContextKind.INDICATOR])
def test_a_model_that_keeps_the_laws_passes(kind: ContextKind) -> None:
    """The first version of a model has no champion to be measured against."""
    verdicts = list(physics_gates(model(kind=kind)))
    assert refused(verdicts) == []
    assert [verdict.gate for verdict in verdicts] == [
        "no-contact",
        *(["turned"] if kind is ContextKind.INDICATOR else []),
        "angle-at-pi",
    ]
    assert all(verdict.figure < 0.01 for verdict in verdicts)


def test_a_visual_model_is_turned_by_turning_its_views() -> None:
    """The views are those that it carries for its self-check."""
    verdicts = list(physics_gates(model(kind=ContextKind.VISUAL)))
    assert "turned" in [verdict.gate for verdict in verdicts]
    assert refused(verdicts) == []


@pytest.mark.parametrize("flaw", ["no-contact", "turned", "angle-at-pi"])
def test_each_law_that_is_broken_is_refused_by_its_gate(flaw: str) -> None:
    """With the figure and the limit in units of the outputs' deviations."""
    verdicts = list(physics_gates(model(flaw)))
    assert flaw in refused(verdicts)
    verdict = next(verdict for verdict in verdicts if verdict.gate == flaw)
    assert verdict.figure > verdict.limit > 0.0
    assert f"{verdict.limit:.3f}" in verdict.meaning
