"""The served model of many bodies: each push of each body is predicted as in a request of its own."""

from pathlib import Path

import numpy as np
import pytest

from service.errors import ContextKindError
from service.inference.bodies_model import BodiesModel
from service.inference.query import ContextBatch, predict
from service.model.predictor import OnnxPredictor
from service.model.tensors import ContextKind
from service.pushing.shape_context import ShapeContext, ShapeTensors
from service.registry.loading import load_version
from service.registry.registry import Registry
from tests.served_graphs import BOX, shape_tensors

PUSHES = np.array([[-0.1, 0.01, 0.0, 0.05], [0.0, 0.1, -1.5, 0.03]])
BODIES = (ShapeContext(BOX), ShapeContext(BOX, (0.02, 0.0), 0.3, pressure=(1.0, 0.0, 1.0)))


def test_each_push_of_each_body_is_predicted(project_root: Path) -> None:
    """The rows are those of single requests, to rounding."""
    model = load_version(Registry(project_root / "models"), OnnxPredictor, "push-shape", 1)
    mean, std = BodiesModel(model, "there")(ShapeTensors(*shape_tensors(*BODIES)), PUSHES)
    assert mean.shape == std.shape == (2, 2, 3)
    for row, body in enumerate(BODIES):
        contexts = ContextBatch(ContextKind.SHAPE, shape_tensors(body), np.zeros(2, dtype=np.int64), "there")
        alone = predict(model, PUSHES.astype(np.float32), contexts)
        assert mean[row] == pytest.approx(alone.mean, abs=1e-5)
        assert std[row] == pytest.approx(alone.std, rel=1e-3)


def test_another_kind_of_model_is_refused(project_root: Path) -> None:
    """A model that takes no outline is refused with the field of the context."""
    model = load_version(Registry(project_root / "models"), OnnxPredictor, "push-none", 2)
    with pytest.raises(ContextKindError, match="there"):
        BodiesModel(model, "there")(ShapeTensors(*shape_tensors(*BODIES)), PUSHES)
