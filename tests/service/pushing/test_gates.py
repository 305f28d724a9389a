"""Physics gates: a version that breaks a law is refused by the gate of that law."""

import math
from dataclasses import dataclass, replace

import numpy as np
import pytest

from service.model.domain import Domain, Verdict
from service.model.loaded_model import LoadedModel
from service.model.manifest import Manifest
from service.model.predictor import OnnxPredictor
from service.model.self_check import flattened
from service.model.tensors import ContextKind, FloatArray, Gaussians, GraphSize, IndexArray, Tensor
from service.pushing.contexts import BITS_PER_SIDE, SIDES, SupportContext
from service.pushing.gates import PUSHING, physics_gates
from service.pushing.onnx_interface import OUTPUTS, OUTPUTS_WITH_UNFAMILIARITY, expected_inputs
from tests.fakes import SMALL, FakePredictor, draft_manifest
from tests.served_graphs import shape_graph

DOMAIN: Domain = PUSHING  # mypy checks here that the class fits the protocol


@dataclass
class Physics:
    """A predictor whose objects move 10 mm away from the pusher, and further for each side of shape 1 that it faces.

    Each flaw breaks one law.
    """

    flaw: str = ""
    size: GraphSize = SMALL

    def predict(
        self, pusher: FloatArray, contexts: tuple[FloatArray, ...], context_index: IndexArray | None
    ) -> Gaussians:
        """See ``service.model.predictor.Predictor``."""
        x, y, angle = pusher[:, :3].astype(np.float64).T
        touches = (x * np.cos(angle) + y * np.sin(angle)) < 0.0
        if self.flaw == "no-contact":
            touches[:] = True
        motion = 0.010 * touches
        if len(contexts) == 1 and context_index is not None and contexts[0].shape[-1] == SIDES * BITS_PER_SIDE:
            concave = contexts[0].reshape(-1, SIDES, BITS_PER_SIDE)[context_index, :, 0]
            facing = np.arctan2(y, x)[:, None] - np.arange(SIDES) * math.pi / 2.0
            motion = motion * (1.0 + (concave * np.maximum(np.cos(facing), 0.0)).sum(axis=1))
        if self.flaw == "angle-at-pi":
            motion = motion * np.where(angle > 0.0, 3.0, 1.0)
        mean = np.column_stack([motion * np.cos(angle), motion * np.sin(angle), np.zeros(len(x))])
        if self.flaw == "turned":
            mean[:, 0] *= 2.0
        return Gaussians(mean.astype(np.float32), np.full((len(x), 3), 1e-3, dtype=np.float32))


def model(flaw: str = "", kind: ContextKind = ContextKind.INDICATOR, manifest: Manifest | None = None) -> LoadedModel:
    """Return a loaded model with the published output deviations and an RMSE of a twentieth of a deviation."""
    found = manifest or draft_manifest(kind=kind)
    metrics = {name: replace(figures, rmse=0.05) for name, figures in found.metrics.items()}
    normalisation = replace(found.normalisation, output_std=[0.0154, 0.0156, 0.215])
    return LoadedModel(replace(found, metrics=metrics, normalisation=normalisation), "", Physics(flaw))


def refused(verdicts: list[Verdict]) -> list[str]:
    """Return the names of the gates that refused."""
    return [verdict.gate for verdict in verdicts if not verdict.passed]


@pytest.mark.parametrize("kind", [ContextKind.NONE, ContextKind.INDICATOR])
def test_a_model_that_keeps_the_laws_passes(kind: ContextKind) -> None:
    """A model that breaks no law passes every gate with a small figure."""
    verdicts = list(physics_gates(model(kind=kind)))
    assert refused(verdicts) == []
    assert [verdict.gate for verdict in verdicts] == [
        "no-contact",
        *(["turned"] if kind is ContextKind.INDICATOR else []),
        "angle-at-pi",
    ]
    assert all(verdict.figure < 0.01 for verdict in verdicts)


def test_a_visual_model_is_turned_by_turning_its_views() -> None:
    """A visual model is tested with the views of its self-check, which are turned as pictures."""
    verdicts = list(physics_gates(model(kind=ContextKind.VISUAL)))
    assert "turned" in [verdict.gate for verdict in verdicts]
    assert refused(verdicts) == []


def test_a_meta_learner_is_turned_by_turning_its_supports() -> None:
    """A model with supports is tested with those of its self-check: pushers and outcomes turn, and headings follow."""
    support = SupportContext.of(np.array([[-0.08, 0.01, 3.0]]), np.array([[0.02, 0.0, 0.3]]))
    stored = tuple(tensor[None] for tensor in support.tensors())
    draft = draft_manifest(kind=ContextKind.SUPPORT)
    draft = replace(draft, self_check=replace(draft.self_check, context=flattened(stored)))
    asked: list[tuple[FloatArray, ...]] = []

    class Recording(Physics):
        """A lawful predictor that keeps the contexts it is asked with."""

        def predict(
            self, pusher: FloatArray, contexts: tuple[FloatArray, ...], context_index: IndexArray | None
        ) -> Gaussians:
            """See ``service.model.predictor.Predictor``."""
            asked.append(contexts)
            return super().predict(pusher, contexts, context_index)

    verdicts = list(physics_gates(replace(model(manifest=draft), predictor=Recording())))
    assert refused(verdicts) == []
    assert [verdict.gate for verdict in verdicts] == ["no-contact", "turned", "angle-at-pi"]
    quarter = [contexts for contexts in asked if abs(contexts[0][0, 0, 1] + 0.08) < 1e-6]
    assert quarter[0][0][0, 0].tolist() == pytest.approx([-0.01, -0.08, 3.0 - 1.5 * math.pi], abs=1e-6)
    assert quarter[0][1][0, 0].tolist() == pytest.approx([0.0, 0.02, 0.3], abs=1e-6)
    assert quarter[0][2].tolist() == stored[2].tolist()


def shapes(flaw: str = "") -> list[Verdict]:
    """Return the verdicts on the small graph of shapes, with a flaw."""
    graph = OnnxPredictor(shape_graph(), expected_inputs(ContextKind.SHAPE), OUTPUTS_WITH_UNFAMILIARITY)

    class Flawed:
        """The graph with a flaw."""

        size = graph.size

        def predict(
            self, rows: FloatArray, contexts: tuple[FloatArray, ...], context_index: IndexArray | None
        ) -> Gaussians:
            """See ``service.model.predictor.Predictor``."""
            found = graph.predict(rows, contexts, context_index)
            moves = found.mean[:, :1] != 0.0
            added = {
                "no-contact": (~moves) * [1e-7, 0, 0],
                "mirrored": moves * [0, 0, 0.1],
                "scale": moves * [0.01, 0, 0],
            }
            return found._replace(mean=(found.mean + added.get(flaw, 0.0)).astype(np.float32))

    return list(physics_gates(replace(model(kind=ContextKind.SHAPE), predictor=Flawed())))


def test_a_shape_model_keeps_more_laws() -> None:
    """A shape model that keeps the laws passes them all, and a push that misses leaves its object exactly at rest."""
    verdicts = shapes()
    assert [verdict.gate for verdict in verdicts] == ["no-contact", "turned", "mirrored", "scale", "angle-at-pi"]
    assert refused(verdicts) == []
    assert (verdicts[0].figure, verdicts[0].limit) == (0.0, 0.0)


@pytest.mark.parametrize("flaw", ["no-contact", "mirrored", "scale"])
def test_a_shape_model_is_refused_by_the_gate_of_a_law_that_it_breaks(flaw: str) -> None:
    """Motion without contact by a ten-thousandth of a millimetre, a turn to one side, and a length of its own fail."""
    assert flaw in refused(shapes(flaw))


@pytest.mark.parametrize("flaw", ["no-contact", "turned", "angle-at-pi"])
def test_each_law_that_is_broken_is_refused_by_its_gate(flaw: str) -> None:
    """A model that breaks a law is refused by the gate of that law, with a figure over the limit."""
    verdicts = list(physics_gates(model(flaw)))
    assert flaw in refused(verdicts)
    verdict = next(verdict for verdict in verdicts if verdict.gate == flaw)
    assert verdict.figure > verdict.limit > 0.0
    assert f"{verdict.limit:.3f}" in verdict.meaning


@pytest.mark.parametrize("kind", ContextKind)
def test_the_domain_has_the_tensors_of_push_models(kind: ContextKind) -> None:
    """A registry gets the inputs of each kind of context, and the outputs of every push model."""
    assert DOMAIN.inputs(kind) == expected_inputs(kind)
    older, newer = (DOMAIN.outputs(kind, number) for number in (2, 3))
    with_distance = (*OUTPUTS, Tensor("unfamiliarity", "float32", ("n", 2), ("1", "1")))
    if kind in (ContextKind.SHAPE, ContextKind.SUPPORT):
        assert older == newer == (with_distance,)
    else:
        assert (older, newer) == ((OUTPUTS,), (OUTPUTS, with_distance))


def test_the_domain_has_the_physics_gates() -> None:
    """A registry gets the verdicts of the physics gates on a loaded version."""
    model = LoadedModel(draft_manifest(), "", FakePredictor(b"", takes_context=True))
    verdicts = list(DOMAIN.gates(model))
    assert verdicts == list(physics_gates(model))
    assert [verdict.gate for verdict in verdicts] == ["no-contact", "turned", "angle-at-pi"]
